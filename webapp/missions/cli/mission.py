"""`expmap mission`: manages the missions of the library, and removes poses of old ones."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import click

from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.cli.library import existing_library, library_option, library_settings, opened_library
from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.errors import Conflict, InputError, NotFound, UsageError
from webapp.files.atomic import write_pieces
from webapp.missions.core.trajectory.axes import AXES
from webapp.missions.core.trajectory.records import SOURCES
from webapp.missions.core.trajectory.robotframe import Start, parse_start
from webapp.missions.files.track_reader import listed, with_axes
from webapp.missions.render.export_file import FORMATS, export_mission_file
from webapp.missions.render.report import NOTATIONS
from webapp.missions.render.report_file import ExportOptions
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.missions.tasks import fuse as fuse_tracks
from webapp.missions.tasks import import_file, read_track, thin_tracks
from webapp.missions.tasks.import_file import TrackImport
from webapp.missions.tasks.import_order import order_of
from webapp.missions.tasks.thin_tracks import Rule, ThinnedTrack
from webapp.render.language import LANGUAGES
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import Account


def _start_option(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--start", callback=_start, metavar="LAT,LON,HEADING",
        help="Where the robot started, and its heading in degrees clockwise from north.",
    )(command)  # fmt: skip


def _start(_context: click.Context, _option: click.Parameter, text: str | None) -> Start | None:
    try:
        return parse_start(text)
    except UsageError as error:
        raise click.BadParameter(f"{error.message}: {error.hint}") from error


@click.command("list")
@click.option("--map", "slug", metavar="SLUG", help="Only missions on that map.")
@library_option
def list_missions(slug: str | None, library: Path | None) -> None:
    """List all missions: number, name, poses, objects, and time of the last change."""
    with _opened(library) as place, place.database.read() as session:
        owner = _owner(place)
        on = None if slug is None else maps.find(session, slug, account=owner).id
        for entry in missions.list_missions(session, owner, part=missions.MissionListPart(map_id=on)):
            mission = entry.mission
            given = (mission.id, mission.name, entry.poses, entry.objects)
            click.echo("\t".join(map(str, [*given, f"{mission.changed_at:%Y-%m-%d %H:%M}"])))


@click.command()
@click.argument("name")
@click.option("--map", "slug", metavar="SLUG", help="Put it on that map.  [default: no map]")
@_start_option
@click.option("--note", default="", metavar="TEXT", help="Note on the mission.")
@library_option
def new(name: str, slug: str | None, start: Start | None, note: str, library: Path | None) -> None:
    """Make a mission and print its number."""
    with _opened(library) as place:
        owner = _owner(place)
        with place.database.write() as session:
            on = None if slug is None else maps.find(session, slug, account=owner).id
            given = start and {**start.position._asdict(), "heading_deg": start.heading_deg}
            made = missions.create(
                session, name, account_id=owner.id, map_id=on, start=given or None, note=note
            )
            session.flush()
            number = made.id
    click.echo(number)


@click.command(
    "import",
    help="Import tracks and objects from FILES into the mission with the number MISSION.\n\n"
    f"{listed()} are recognised by their content. Importing a file again stores nothing twice.",
)
@click.argument("mission", type=int)
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--topic", "topics", multiple=True, metavar="NAME", help="Only this topic or line; repeatable.")
@click.option("--list", "listing", is_flag=True, help="Print the topics of bags instead.")
@click.option(
    "--columns",
    metavar="TEXT",
    help="Columns of a CSV: time=stamp:ms, lat=Latitude, lon=3 ...  [default: from its header]",
)
@click.option(
    "--source", type=click.Choice(SOURCES), help="Source of all tracks.  [default: by the kind of file]"
)
@click.option("--axes", type=click.Choice(AXES), help=f"Axes of {with_axes()} files.  [default: detected]")
@click.option(
    "--min-move", metavar="DISTANCE",
    help="Leave out poses that moved less: 0.5m, 0.00001deg, or 0.  [default: 0.00001deg]",
)  # fmt: skip
@_start_option
@library_option
def import_files(
    mission: int, files: tuple[Path, ...], listing: bool, library: Path | None, **given: Any
) -> int:
    """Import files with tracks."""
    if listing:
        for path in files:
            _print_topics(path)
        return DONE
    failed = 0
    with _opened(library) as place, terminal_progress("importing") as progress:
        for path in files:
            form = given | {"name": path.name, "topics": ",".join(given["topics"]), "start": None}
            order = order_of(path, form)
            order = replace(order, options=replace(order.options, start=given["start"]))
            try:
                done = import_file.import_track_file(
                    place, mission, order=order, settings=load_settings(), progress=progress
                )
            except InputError as error:
                click.echo(f"expmap: {error}", err=True)
                failed += 1
            else:
                _print_import(path, done)
    return SOME_FAILED if failed else DONE


@click.command()
@click.argument("mission", type=int)
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False, allow_dash=True))
@click.option("--format", "form", type=click.Choice(FORMATS), help="[default: from the name of FILE]")
@click.option("--language", type=click.Choice(LANGUAGES), default="en", help="Of a report.  [default: en]")
@click.option(
    "--zone", default="UTC", metavar="NAME", help="Time zone of a report: Europe/Prague.  [default: UTC]"
)
@click.option(
    "--positions", type=click.Choice(list(NOTATIONS)), default="degrees",
    help="Notation of positions in a report, beside decimal degrees.",
)  # fmt: skip
@library_option
def export(mission: int, file: Path, form: str | None, library: Path | None, **written: str) -> None:
    """Export the mission with the number MISSION to FILE; `-` is standard output."""
    form = form or _form_of(file)
    with _opened(library) as place:
        with place.database.read() as session:
            _known(session.get(Mission, mission), mission)
        download = export_mission_file(
            place,
            mission,
            form=form,
            settings=library_settings(library),
            options=ExportOptions(private=True, photos=True, **written),  # type: ignore[arg-type]
        )
        if str(file) == "-":
            for piece in download.pieces:
                sys.stdout.buffer.write(piece)
        else:
            write_pieces(file, download.pieces)
            click.echo(file)


@click.command()
@click.argument("mission", type=int)
@click.option(
    "--odometry", type=int, metavar="TRACK",
    help="Id of the odometry to correct, if the mission has several.  [default: the longest]",
)  # fmt: skip
@library_option
def fuse(mission: int, odometry: int | None, library: Path | None) -> None:
    """Fuse the tracks of the mission with the number MISSION into a corrected one."""
    with _opened(library) as place:
        with place.database.read() as session:
            _known(session.get(Mission, mission), mission)
        with terminal_progress("fusing") as progress:
            report = fuse_tracks.fuse_mission(
                place, mission, write=place.database.write, progress=progress, odometry=odometry
            )
    used = f"odometry {report['odometry']} {report['odometry_name']!r}"
    click.echo(f"{report['poses']} poses from {used if report['odometry'] else 'fixes without odometry'}")
    for one in report["fixes"]:
        click.echo(f"{one['source']}: {one['used']} fixes used, {one['gated']} left out")
    for one in report["too_sure"]:
        click.echo(
            f"{one['source']} (track {one['track']}) was too sure: its errors were {one['factor']:.1f} times "
            f"what it stated, since {_utc(one['since_s'])}"
        )
    for one in report["shifted"]:
        off_m = math.hypot(one["east_m"], one["north_m"])
        click.echo(
            f"{one['source']} (track {one['track']}) was {off_m:.0f} m off from {_utc(one['from_s'])} "
            f"to {_utc(one['to_s'])}: {one['fixes']} fixes were left out"
        )


def _utc(time_s: float) -> str:
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _form_of(file: Path) -> str:
    name = f".{file.name.lower()}"
    fits = [form for form in FORMATS if name.endswith((f".{form}", f"-{form}"))]
    if not fits:
        hint = f"give it: --format {'|'.join(FORMATS)}"
        raise UsageError("the format cannot be inferred from the file name", where=str(file), hint=hint)
    return max(fits, key=len)


def _known(found: Mission | None, number: int) -> Mission:
    if found is None:
        raise NotFound("mission not found", where=f"mission {number}", hint="see: expmap mission list")
    return found


def _print_topics(path: Path) -> None:
    for topic in read_track.topics(path):
        used = "" if topic.readable else "\tnot used"
        click.echo(f"{topic.name}\t{topic.type}\t{topic.messages}{used}")


def _print_import(path: Path, done: TrackImport) -> None:
    for track in done.tracks:
        click.echo(
            f"{path.name}: {track.source} {track.name!r}: {track.poses} poses, {track.skipped} left out (not "
            f"moved), {track.distance_m:.1f} m"
        )
    if done.objects:
        click.echo(f"{path.name}: {done.objects} sightings of objects")
    if not done.new:
        click.echo(f"{path.name}: everything in it was already imported", err=True)
    for one in done.skipped:
        click.echo(f"{path.name}: {one.where}: left out: {one}", err=True)
    for one in done.doubts:
        click.echo(f"{path.name}: {one.where}: odd: {one}", err=True)
    for note in done.notes:
        click.echo(f"{path.name}: {note}", err=True)


@contextmanager
def _opened(folder: Path | None) -> Iterator[Library]:
    with opened_library(library_settings(folder)) as library:
        yield library


def _owner(library: Library) -> Account:
    with library.database.write() as session:
        return accounts.ensure_owner(session)


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
