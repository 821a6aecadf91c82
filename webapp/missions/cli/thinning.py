"""`expmap mission thin`, `prune` and `keep`: remove poses of old missions, or exempt missions from that."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.errors import Conflict, NotFound, UsageError
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.missions.tasks import thin_tracks
from webapp.missions.tasks.thin_tracks import Rule, ThinnedTrack
from webapp.settings import Settings

_missions = click.argument("numbers", nargs=-1, type=int, metavar="[MISSION]...")


def _common(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the arguments and options that `thin` and `prune` share."""
    for option in (
        library_option,
        click.option("--dry-run", is_flag=True, help="Only print what would be done."),
        click.option(
            "--older-than", "days", type=click.FloatRange(min=0), metavar="DAYS",
            help="Only missions that have not changed for this long.  [default: from the settings]",
        ),
        _missions,
    ):  # fmt: skip
        command = option(command)
    return command


@click.command()
@_common
@click.option(
    "--to", "metres", type=click.FloatRange(min=0, min_open=True), metavar="METRES",
    help="Largest error.  [default: missions.thin_to_m]",
)  # fmt: skip
def thin(
    numbers: tuple[int, ...], metres: float | None, days: float | None, dry_run: bool, library: Path | None
) -> int:
    """Remove poses from the tracks of missions, keeping the error below a limit at all times.

    Without MISSION, all old missions are thinned. Missions that are under way, in the bin, or marked to be
    kept stay as they are; objects, photos, and both ends of each track are kept.
    """
    settings = library_settings(library)
    days = _days(numbers, days, settings.missions.thin_after_days)
    rule = Rule(settings.missions.thin_to_m if metres is None else metres, timedelta(days=days))
    return _thin(numbers, rule, settings=settings, dry_run=dry_run)


@click.command()
@_common
def prune(numbers: tuple[int, ...], days: float | None, dry_run: bool, library: Path | None) -> int:
    """Remove all poses from the tracks of missions except the first and the last.

    Missions are chosen as for `expmap mission thin`.
    """
    settings = library_settings(library)
    days = _days(numbers, days, settings.missions.prune_after_days)
    return _thin(numbers, Rule(None, timedelta(days=days)), settings=settings, dry_run=dry_run)


@click.command()
@click.argument("numbers", nargs=-1, required=True, type=int, metavar="MISSION...")
@click.option("--off", is_flag=True, help="Remove the mark.")
@library_option
def keep(numbers: tuple[int, ...], off: bool, library: Path | None) -> None:
    """Mark missions to be kept as they are, whatever the settings say about old missions."""
    with existing_library(library_settings(library)) as place, place.database.write() as session:
        for number in numbers:
            found = session.get(Mission, number)
            if found is None:
                raise NotFound(
                    "mission not found", where=f"mission {number}", hint="see: expmap mission list"
                )
            found.keep = not off
            missions.count_change(found)


def _days(numbers: tuple[int, ...], given: float | None, setting: float) -> float:
    """Return the minimum age in days: by default 0 for missions that are named, otherwise the setting."""
    if given is not None:
        return given
    return 0.0 if numbers else setting


def _thin(numbers: tuple[int, ...], rule: Rule, *, settings: Settings, dry_run: bool) -> int:
    if not numbers and not rule.after:
        raise UsageError(
            "no missions were given",
            hint="give their numbers, or --older-than DAYS; with the current settings all are kept",
        )
    failed = tracks = removed = 0
    with existing_library(settings) as place, terminal_progress("thinning") as progress:
        with place.database.read() as session:
            too_recent = thin_tracks.too_recent(session, numbers, rule=rule)
            ids = (
                [id for id in numbers if id not in too_recent] if numbers else thin_tracks.due(session, rule)
            )
        for id in too_recent:
            days = rule.after / timedelta(days=1)
            click.echo(f"mission {id} is skipped: it changed less than {days:g} days ago")
        progress.size(len(ids))
        for id in ids:
            try:
                for track in thin_tracks.thin_mission(
                    place, id, rule=rule, write=place.database.write, progress=progress, dry_run=dry_run
                ):
                    _print(track, dry_run=dry_run)
                    tracks, removed = tracks + 1, removed + track.before - track.after
            except (Conflict, NotFound) as error:
                click.echo(f"expmap: {error}", err=True)
                failed += 1
            progress.advance()
    would = "would be " if dry_run else ""
    click.echo(f"{removed} poses of {tracks} tracks {would}removed")
    return SOME_FAILED if failed else DONE


def _print(track: ThinnedTrack, *, dry_run: bool) -> None:
    would = "would have" if dry_run else "has"
    name = f" {track.name!r}" if track.name else ""
    click.echo(f"mission {track.mission}: {track.source}{name} {would} {track.after} of {track.before} poses")
