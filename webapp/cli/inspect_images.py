"""`expmap map inspect`: shows how photos and plans are understood."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.files.photos.exif_gps import Gps
from webapp.files.photos.photo import PhotoFacts
from webapp.files.photos.sidecars import is_sidecar
from webapp.tasks.maps.inspect_images import ImageReport, PlanFacts, as_json, inspect_image

_NORTH = {"T": "true north", "M": "magnetic north", None: "unknown north"}


@click.command("inspect", short_help="Show how photos and plans are understood.")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--json", "as_lines", is_flag=True, help="Print one JSON object per file, one per line.")
def inspect(files: tuple[Path, ...], as_lines: bool) -> int:
    """Show how FILES, photos and plans, are understood: size, position and its source, heading, notes.

    Files with metadata beside photos (`.xmp`, Google's JSON) are read with these. Nothing is stored, and no
    library is needed. Exit code 1 when a file cannot be read.
    """
    failed = 0
    for path in [one for one in files if not is_sidecar(one.name)] or files:
        report = inspect_image(path, settings=settings_in_use(path))
        failed += not report.is_read
        click.echo(json.dumps(as_json(report), ensure_ascii=False) if as_lines else "\n".join(_lines(report)))
    return SOME_FAILED if failed else DONE


def _lines(report: ImageReport) -> Iterator[str]:
    facts, plan = report.photo, report.plan
    if facts is None:
        hint = f" ({report.hint})" if report.hint else ""
        yield f"{report.name}: not usable as a photo: {report.problem}{hint}"
    else:
        turned = f", turned (EXIF orientation {facts.orientation})" if facts.orientation != 1 else ""
        kind = "panorama, " if report.is_panorama else ""
        yield f"{report.name}: {kind}{facts.format}, {facts.width} x {facts.height} pixels{turned}"
        yield from (f"  {line}" for line in _photo_lines(facts, is_panorama=report.is_panorama))
    if plan is not None:
        yield f"  as a plan: {_plan_line(plan)}"


def _photo_lines(facts: PhotoFacts, *, is_panorama: bool) -> Iterator[str]:
    yield f"position: {_position(facts)}"
    if facts.heading is not None:
        yield f"heading: {facts.heading.deg:.1f} degrees from {_NORTH[facts.heading.reference]}"
    if facts.pitch_deg is not None:
        yield f"pitch: {facts.pitch_deg:.1f} degrees"
    if is_panorama:
        yield "field of view: 360 degrees"
    elif facts.fov is not None:
        yield f"field of view: {facts.fov.deg:.1f} degrees, from {facts.fov.source}"
    else:
        yield "field of view: unknown"
    if facts.taken_at is not None:
        yield f"taken: {facts.taken_at}"
    if facts.camera is not None:
        yield f"camera: {facts.camera}"
    yield from (f"note: {note}" for note in facts.notes)


def _position(facts: PhotoFacts) -> str:
    gps = facts.gps
    if not isinstance(gps, Gps):
        return f"none: {gps.reason}"
    parts = [f"{gps.lat:.7f}, {gps.lon:.7f} from {gps.source}"]
    if gps.accuracy_m is not None:
        parts.append(f"within {gps.accuracy_m:.2g} m")
    if gps.altitude_m is not None:
        parts.append(f"altitude {gps.altitude_m:.1f} m")
    if gps.relative_altitude_m is not None:
        parts.append(f"{gps.relative_altitude_m:.1f} m above the start")
    return ", ".join(parts)


def _plan_line(plan: PlanFacts) -> str:
    parts = [f"{plan.width} x {plan.height} pixels"]
    if plan.georeference is not None:
        parts.append(f"georeference in {plan.georeference.plane}, {plan.metres_per_pixel:.3g} m per pixel")
    elif plan.problem is not None:
        parts.append(plan.problem)
    if plan.worldfile is not None:
        parts.append(f"world file {plan.worldfile}")
    return ", ".join(parts)
