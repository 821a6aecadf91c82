"""`expmap map place-rest`: place the photos in the tray by means of the placed ones."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import fmean

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.options import MAP_FILE
from webapp.cli.progressbar import terminal_progress
from webapp.settings import Settings, keep_freed_memory
from webapp.tasks.landmarks import photo_pieces
from webapp.tasks.landmarks.accept import (
    accept_in_folder,
    accept_in_library,
    correct_in_folder,
    correct_in_library,
    library_of,
    owner_of,
)
from webapp.tasks.landmarks.photo_pieces import PiecesReport
from webapp.tasks.landmarks.place_rest import RestReport, suggest_rest
from webapp.tasks.landmarks.stored import as_json as report_as_json
from webapp.tasks.photo_plan import direction_of


@click.command("place-rest", short_help="Place the photos in the tray using those already placed.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option("--accept", is_flag=True, help="Place them, as one step that can be undone in the editor.")
@click.option(
    "--within",
    type=click.FloatRange(0.0, min_open=True),
    metavar="PX",
    help="With --accept: only photos whose radius is at most this many pixels.",
)
@click.option(
    "--correct", is_flag=True, help="Move photos placed by their GPS to where all photos together put them."
)
@click.option(
    "--check", is_flag=True, help="List the placed photos by how far they are from where the others put them."
)
@click.option(
    "--pieces", is_flag=True,
    help="Check in seconds which photos can be joined at all, and where photos are missing.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def place_rest(
    cfg: Path,
    accept: bool,
    within: float | None,
    correct: bool,
    check: bool,
    pieces: bool,
    as_json: bool,
) -> None:
    """Suggest where the photos in the tray of a map were taken, using the photos already placed.

    All photos are joined by structure from motion and aligned with the map by the placed ones; a dozen of
    those are often enough. Photos that cannot be joined stay in the tray, with the reason. Nothing is changed
    without --accept or --correct. It can be interrupted at any time; the next run computes only new photos.
    Joining improves the positions of photos placed by their GPS, too: --correct moves these photos there.
    With --check the placed photos are listed instead, starting with those that contradict the others.
    With --pieces, small pictures of the photos are compared instead: into how many pieces they will fall,
    which photos are in none, and between which ones to take more. It needs no placed photo.
    """
    if pieces and (accept or correct or check):
        raise click.UsageError("--pieces cannot be used with --accept, --correct or --check")
    if check and (accept or correct):
        raise click.UsageError("--check changes nothing: it cannot be used with --accept or --correct")
    if within is not None and not accept:
        raise click.UsageError("--within can only be used with --accept")
    keep_freed_memory()
    settings = settings_in_use(cfg)
    if pieces:
        _check_pieces(cfg, settings=settings, as_json=as_json)
        return
    with library_of(cfg, settings=settings) as there:
        with terminal_progress("photos") as progress:
            report = suggest_rest(cfg, settings=settings, progress=progress, check=check)
        chosen = [one for one in report.suggested if within is None or one.radius_px <= within]
        if accept and chosen:
            if there is None:
                accept_in_folder(cfg, chosen)
            else:
                library, map_id = there
                accept_in_library(library, map_id, suggested=chosen, account_id=owner_of(library))
        if correct and report.corrected:
            if there is None:
                correct_in_folder(cfg, report.corrected)
            else:
                library, map_id = there
                owner = owner_of(library)
                correct_in_library(library, map_id, corrected=report.corrected, account_id=owner)
    accepted = {one.id for one in chosen} if accept else set()
    click.echo(
        json.dumps(report_as_json(report, accepted=accepted), indent=1)
        if as_json
        else _check_table(report)
        if check
        else _table(report, accepted)
    )
    _print_notes(cfg, report, accepted)
    if report.corrected:
        _print_corrections(report, are_moved=correct)


def _check_pieces(cfg: Path, *, settings: Settings, as_json: bool) -> None:
    with terminal_progress("pairs") as progress:
        report = photo_pieces.check_pieces(cfg, settings=settings, progress=progress)
    if as_json:
        click.echo(json.dumps(photo_pieces.as_json(report), indent=1))
    else:
        click.echo("\n".join(_piece_lines(report)))
    for id, reason in report.failed.items():
        click.echo(f"warning: {report.names[id]} (id {id}): {reason}", err=True)
    count = len(report.pieces)
    click.echo(
        f"{cfg}: {count} piece{'s' * (count != 1)} of {sum(map(len, report.pieces))} photos, "
        f"photos in none: {len(report.alone)}",
        err=True,
    )
    if report.place_next:
        ids = ", ".join(map(str, report.place_next))
        click.echo(f"place these photos by hand first (ids): {ids}", err=True)


def _piece_lines(report: PiecesReport) -> list[str]:
    """List the pieces, the photos in none, those that bridge pieces, and between which to take more."""
    names = report.names
    lines = [
        f"piece {number}: {len(piece)} photos, {', '.join(names[id] for id in piece)}"
        for number, piece in enumerate(report.pieces, start=1)
    ]
    lines += [f"in no piece: {names[id]}" for id in report.alone]
    lines += [f"almost connects pieces: {names[id]}" for id in report.bridges]
    for gap in report.gaps:
        shared = f"they share {gap.matches} points" if gap.matches else "they show nothing in common"
        lines.append(f"take photos between {names[gap.photo]} and {names[gap.other]}: {shared}")
    return lines


def _table(report: RestReport, accepted: set[int]) -> str:
    width = max(map(len, [*(s.photo for s in report.suggested), *(p.photo for p in report.left)]), default=0)
    lines = []
    for one in report.suggested:
        x, y = one.position
        heading = "" if one.heading_deg is None else f", heading {one.heading_deg:.0f} degrees"
        done = "; placed" if one.id in accepted else ""
        lines.append(
            f"{one.photo:{width}}  x {x:.1f}, y {y:.1f}, within {one.radius_px:.1f} px{heading}{done}"
        )
    lines += [f"{one.photo:{width}}  {one.reason}" for one in report.left]
    return "\n".join(lines)


def _check_table(report: RestReport) -> str:
    """List the placed photos that are joined with others: contradictions first, then by falling residual."""
    known = [one for one in report.checked if one.predicted is not None]
    known.sort(key=lambda one: (not one.contradicts, -(one.residual_px or 0.0)))
    width = max((len(one.photo) for one in known), default=0)
    lines = []
    for one in known:
        x, y = one.predicted or (0.0, 0.0)
        metres = "" if one.residual_m is None else f" ({one.residual_m:.1f} m)"
        word = "; contradicts them" if one.contradicts else ""
        off = f"{one.residual_px or 0.0:.1f} px{metres}"
        lines.append(f"{one.photo:{width}}  {off} from where the others put it, x {x:.1f}, y {y:.1f}{word}")
    return "\n".join(lines) or "no placed photo is joined with two others"


def _print_notes(cfg: Path, report: RestReport, accepted: set[int]) -> None:
    """Print contradictions, counts, and the photos to place next to standard error."""
    for one in report.checked:
        if one.contradicts:
            metres = "" if one.residual_m is None else f" ({one.residual_m:.0f} m)"
            where = "away" if one.bearing_deg is None else f"to the {direction_of(one.bearing_deg)}"
            click.echo(
                f"warning: {one.photo} (id {one.id}) contradicts the other placed photos: they put it "
                f"{one.residual_px or 0.0:.0f} px{metres} {where}",
                err=True,
            )
    done = f", {len(accepted)} placed" if accepted else ""
    click.echo(f"{cfg}: {len(report.suggested)} photos joined, {len(report.left)} not{done}", err=True)
    unchecked = sum(not one.is_checked for one in report.suggested)
    if unchecked:
        click.echo(
            f"{unchecked} of them follow from two placed photos, which do not show how far off they are: "
            "place a third one, far from both",
            err=True,
        )
    if report.place_next:
        ids = ", ".join(str(id) for id in report.place_next)
        click.echo(f"placing these photos by hand would help most (ids): {ids}", err=True)


def _print_corrections(report: RestReport, *, are_moved: bool) -> None:
    """Print to standard error how far photos placed by GPS are from their reconstructed positions."""
    metres = fmean(one.moved_m for one in report.corrected)
    farthest = max(report.corrected, key=lambda one: one.moved_m)
    done = "were moved" if are_moved else "would be moved by --correct"
    click.echo(
        f"{len(report.corrected)} photos placed by GPS {done}: by {metres:.1f} m on average, at most by "
        f"{farthest.moved_m:.1f} m ({farthest.photo})",
        err=True,
    )
