"""`expmap map from-photos`: a map from the GPS positions of a folder of photos."""

from __future__ import annotations

import json
from pathlib import Path

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.core.geo.controlpoints import Model
from webapp.errors import UsageError
from webapp.tasks.maps import from_photos as map_from_photos
from webapp.tasks.maps.place_photos import FileResult
from webapp.tasks.maps.survey_photos import State
from webapp.tasks.satellite.georeference_image import GeoSource

_BESIDE = Path()
_FILE = click.Path(path_type=Path)


@click.command("from-photos", short_help="Make a map from the photos in a folder.")
@click.argument("folder", type=_FILE)
@click.option("-o", "--output", "cfg", type=_FILE, required=True, metavar="MAP.cfg", help="The map to write.")
@click.option("--satellite", type=_FILE, metavar="IMAGE", help="Satellite image; inside the map's folder.")
@click.option("--corners", type=_FILE, metavar="FILE", help="JSON with the positions of the image's corners.")
@click.option("--geotiff", is_flag=True, help="The image is a GeoTIFF and says itself where it is.")
@click.option(
    "--worldfile", type=_FILE, is_flag=False, flag_value=_BESIDE, metavar="[FILE]",
    help="World file; without FILE the one beside the image.",
)  # fmt: skip
@click.option("--control-points", type=_FILE, metavar="FILE", help="Table x;y;lat;lon of known points.")
@click.option("--crs", metavar="CRS", help="Coordinate system of the world file or GeoTIFF: EPSG:32633 ...")
@click.option(
    "--model", type=click.Choice(["similarity", "affine", "projective"]),
    help="How control points are fitted; default: the richest that their number allows.",
)  # fmt: skip
@click.option("--blank", is_flag=True, help="Make a blank plan around the photos instead of an image.")
@click.option(
    "--positions", type=_FILE, metavar="FILE",
    help="Positions by file name instead of EXIF: a .cfg, or a table name;lat;lon or name;x;y.",
)  # fmt: skip
@click.option("--copy", is_flag=True, help="Copy photos and image from elsewhere into the map's folder.")
@click.option("--force", is_flag=True, help="Replace a map that exists; its photos keep their ids.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as one JSON object.")
@click.pass_context
def from_photos(
    ctx: click.Context,
    folder: Path,
    cfg: Path,
    satellite: Path | None,
    corners: Path | None,
    geotiff: bool,
    worldfile: Path | None,
    control_points: Path | None,
    crs: str | None,
    model: Model | None,
    blank: bool,
    positions: Path | None,
    copy: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Make a map from the photos in FOLDER and the folders below it.

    Each photo's EXIF GPS position becomes a pixel of the satellite image, or of a blank plan. Every file is
    listed: placed, without a position, outside the image, unreadable, or not a photo. Exit code 1 when a
    photo could not be read or none could be placed.
    """
    if blank == (satellite is not None):
        raise UsageError("give either --satellite IMAGE or --blank", where="--satellite")
    kinds: list[GeoSource] = []
    if corners is not None:
        kinds.append(GeoSource("corners", corners, crs, model))
    if geotiff:
        kinds.append(GeoSource("geotiff", None, crs, model))
    if worldfile is not None:
        kinds.append(GeoSource("worldfile", None if worldfile == _BESIDE else worldfile, crs, model))
    if control_points is not None:
        kinds.append(GeoSource("control-points", control_points, crs, model))
    if len(kinds) > 1:
        names = " and ".join(f"--{kind.kind}" for kind in kinds)
        raise UsageError(f"{names} exclude each other", hint="choose one of them")
    if not kinds and (crs or model):
        raise UsageError("--crs and --model go with a source of the georeference", hint="add one of them")
    options = map_from_photos.Options(
        cfg, satellite, next(iter(kinds), None), positions=positions, copy=copy, force=force
    )
    with terminal_progress("photos") as progress:
        report = map_from_photos.map_from_photos(
            folder, options=options, settings=load_settings(), progress=progress
        )
    _tell(report)
    click.echo(json.dumps(_as_json(report), indent=1, ensure_ascii=False) if as_json else _table(report))
    if report.count(State.UNREADABLE) or not report.written:
        ctx.exit(SOME_FAILED)


def _tell(report: map_from_photos.Report) -> None:
    """Say on standard error what is no result: residuals, warnings, that nothing was written."""
    if report.residuals_m:
        metres = " ".join(f"{residual:.3g}" for residual in report.residuals_m)
        click.echo(f"residuals of the control points, metres: {metres}", err=True)
    for warning in report.warnings:
        click.echo(f"warning: {warning}", err=True)
    if not report.written:
        click.echo("no photo could be placed: no map was written", err=True)


def _table(report: map_from_photos.Report) -> str:
    width = max((len(file.name) for file in report.files), default=0)
    lines = []
    for file in report.files:
        told = [file.reason] if file.reason else []
        if file.experience is not None:
            x, y = file.experience.position
            told.append(f"id {file.experience.id} at x {x:.1f}, y {y:.1f}")
        lines.append(f"{file.name:{width}}  {file.state:17}  {'; '.join((*told, *file.notes))}".rstrip())
    counts = ", ".join(f"{report.count(state)} {state}" for state in State)
    return "\n".join([*lines, f"{len(report.files)} files: {counts}"])


def _as_json(report: map_from_photos.Report) -> dict[str, object]:
    image = report.satellite
    return {
        "map": str(report.cfg) if report.written else None,
        "satellite": image and {"path": image.path, "width": image.width, "height": image.height},
        "counts": {str(state): report.count(state) for state in State},
        "residuals_m": list(report.residuals_m),
        "warnings": list(report.warnings),
        "files": [_file_as_json(file) for file in report.files],
    }


def _file_as_json(file: FileResult) -> dict[str, object]:
    e = file.experience
    return {
        "name": file.name,
        "state": str(file.state),
        "reason": file.reason,
        "id": e and e.id,
        "x_px": e and e.position.x,
        "y_px": e and e.position.y,
        "lat": file.latlon and file.latlon.lat,
        "lon": file.latlon and file.latlon.lon,
        "heading_deg": e and e.heading_deg,
        "fov_deg": e and e.fov_deg,
        "gps_accuracy_m": e and e.gps_accuracy_m,
        "taken_at": e and e.taken_at,
        "notes": list(file.notes),
    }
