"""`expmap map`: check, calibrate and make maps, show how files are understood, write positions into EXIF."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.exitcodes import BAD_MAP, DONE, SOME_FAILED
from webapp.cli.options import MAP_FILE, chosen_settings, index_options, map_options, open_options
from webapp.cli.progressbar import terminal_progress
from webapp.core.geo.fit import Model
from webapp.core.hypotheses.places import KIND_WORDS
from webapp.core.mapmodel.findings import Finding
from webapp.core.texts import significant
from webapp.errors import UsageError
from webapp.files.photos.exif import Gps
from webapp.files.photos.photo import PhotoFacts
from webapp.files.photos.sidecars import is_sidecar
from webapp.progress import Progress
from webapp.tasks.exchange.export_source import of_folder
from webapp.tasks.exchange.write_exif import PhotoCopy
from webapp.tasks.exchange.write_exif import write_exif as copy_photos
from webapp.tasks.localize.calibrate import keep_queries, queries_file
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.maps import check_map
from webapp.tasks.maps import from_photos as map_from_photos
from webapp.tasks.maps.inspect_images import ImageReport, PlanFacts, as_json, inspect_image
from webapp.tasks.maps.place_photos import FileResult, FileState
from webapp.tasks.satellite.georeference import GeoSource

_SHOWN = {"error": 20, "warning": 5}
"""Maximum number of findings of one kind that are printed per file; --json has all."""

_FILE = click.Path(path_type=Path)
_ELEVATION = click.FloatRange(0.0, 90.0)

_BESIDE = Path()

_NORTH = {"T": "true north", "M": "magnetic north", None: "unknown north"}


@click.command("check")
@click.argument("cfg", metavar="MAP.cfg", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def check(ctx: click.Context, cfg: Path, as_json: bool) -> None:
    """Check a map file and say how to fix what is wrong.

    Looks at the .cfg, the map.json and placements next to it, the satellite image and every photo.
    Exit code 3 when the map has errors; warnings alone leave it usable.
    """
    report = check_map.check_map(cfg, settings=settings_in_use(cfg), progress=Progress())
    if as_json:
        click.echo(json.dumps(_as_json(report), indent=1))
    else:
        _print(report)
    counts = ((report.photos, "photo"), (report.errors, "error"), (report.warnings, "warning"))
    summary = ", ".join(f"{count} {noun}{'s' * (count != 1)}" for count, noun in counts)
    click.echo(f"{cfg}: {summary}", err=True)
    if report.places is not None and not as_json:
        kind, radius_px = KIND_WORDS[report.places.kind], report.places.radius_px
        click.echo(f"{cfg}: by its positions {kind}; an answer is right within {radius_px:.0f} px", err=True)
    if report.errors:
        ctx.exit(BAD_MAP)


def _print(report: check_map.CheckReport) -> None:
    """Print the findings, but only the first ones of each kind per file."""
    seen: Counter[tuple[str, str]] = Counter()
    most: dict[tuple[str, str], int] = {}
    for finding in report.findings:
        kind = (finding.file, finding.code)
        seen[kind] += 1
        most[kind] = _SHOWN[finding.severity]
        if seen[kind] <= most[kind]:
            place = f"{_file(report, finding)}:{finding.line}:{finding.column}"
            click.echo(
                f"{place}: {finding.severity}: {finding.message} ({finding.code})\n    fix: {finding.fix}"
            )
    for (file, code), count in seen.items():
        if count > most[file, code]:
            name = report.cfg_path.with_name(file) if file else report.cfg_path
            click.echo(f"{name}: {count - most[file, code]} more of {code}; --json lists all", err=True)


def _file(report: check_map.CheckReport, finding: Finding) -> Path:
    return report.cfg_path.with_name(finding.file) if finding.file else report.cfg_path


def _as_json(report: check_map.CheckReport) -> dict[str, object]:
    findings = [
        {
            "file": str(_file(report, finding)),
            "line": finding.line,
            "column": finding.column,
            "severity": finding.severity,
            "code": str(finding.code),
            "message": finding.message,
            "fix": finding.fix,
        }
        for finding in report.findings
    ]
    places = report.places
    return {
        "photos": report.photos,
        "errors": report.errors,
        "warnings": report.warnings,
        "map_kind": None if places is None else places.kind,
        "place_radius_px": None if places is None else places.radius_px,
        "findings": findings,
    }


@click.command("calibrate", short_help="Calibrate a map's probabilities, also on real queries.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option(
    "--queries", type=_FILE, metavar="QUERIES.csv", help="Photos with true positions; replaces the last list."
)
@click.option("--forget", is_flag=True, help="Remove the list of real queries.")
@index_options
@map_options
def calibrate_command(cfg: Path, queries: Path | None, forget: bool, **chosen: Any) -> None:
    """Calibrate the probabilities of a map on its own photos and on real queries.

    QUERIES.csv is a list as for `expmap evaluate`. It is kept next to the map as NAME.queries.csv; the photos
    stay where they are. The more there are, the less the map's own photos count.
    """
    if forget and queries is not None:
        raise UsageError("cannot be used with --queries", where="--forget")
    settings = chosen_settings(cfg, chosen)
    if queries is not None:
        keep_queries(cfg, queries, limits=settings.photo)
    elif forget:
        queries_file(cfg).unlink(missing_ok=True)
    with terminal_progress("photos") as progress:
        pipeline = open_pipeline(cfg, open_options(chosen), settings=settings, progress=progress)
    for look in pipeline.looks:
        if look.calibration is not None:
            real, own = (
                look.calibration.queries,
                look.calibration.calibration.cases - look.calibration.queries,
            )
            click.echo(
                f"{look.features}: calibrated on {own} of the map's own photos and {real} real queries"
            )


@click.command("write-exif", short_help="Write positions into the EXIF of photos, or of copies.")
@click.argument("cfg", metavar="MAP.cfg", type=_FILE)
@click.option("-o", "--out", type=_FILE, metavar="FOLDER", help="Where the copies go.")
@click.option(
    "--in-place", is_flag=True, help="Change the photos themselves; the originals are kept as NAME_original."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def write_exif(ctx: click.Context, cfg: Path, out: Path | None, in_place: bool, as_json: bool) -> None:
    """Write the positions and headings of a map into the EXIF of its photos: into copies, or in place.

    The map needs a georeference. Copies never replace a file in FOLDER, and the originals stay as they are;
    in place, each original is kept next to its photo, the first time. Exit code 1 when a photo could not be
    written.
    """
    if (out is None) != in_place:
        raise click.UsageError("give either --out FOLDER or --in-place")
    settings = settings_in_use(cfg)
    with terminal_progress("photos") as progress:
        copies = list(copy_photos(of_folder(cfg), out, limits=settings.photo, progress=progress))
    written = sum(one.position is not None for one in copies)
    if as_json:
        click.echo(
            json.dumps({"written": written, "photos": [_copy_as_json(one) for one in copies]}, indent=1)
        )
    else:
        for one in copies:
            click.echo(_copy_line(one))
    done = "written in place" if in_place else "copied"
    click.echo(f"{cfg.parent if in_place else out}: {written} of {len(copies)} photos {done}", err=True)
    if written < len(copies):
        ctx.exit(SOME_FAILED)


def _copy_as_json(one: PhotoCopy) -> dict[str, object]:
    lat, lon = one.position or (None, None)
    facts = asdict(one)
    del facts["position"]
    return facts | {"written": one.position is not None, "lat": lat, "lon": lon}


def _copy_line(one: PhotoCopy) -> str:
    facts = []
    if one.position is None:
        facts.append("not written")
    else:
        facts.append(f"{one.position.lat:.7f}, {one.position.lon:.7f}")
        if one.heading_deg is not None:
            facts.append(f"{one.heading_deg:.1f} degrees")
    if one.reason:
        facts.append(one.reason)
    return f"{one.photo}  {'; '.join(facts)}"


@click.command("from-photos", short_help="Make a map from the photos in a folder.")
@click.argument("folder", type=_FILE)
@click.option("-o", "--output", "cfg", type=_FILE, required=True, metavar="MAP.cfg", help="The map to write.")
@click.option("--satellite", type=_FILE, metavar="IMAGE", help="Satellite image; inside the map's folder.")
@click.option("--corners", type=_FILE, metavar="FILE", help="JSON with the positions of the image's corners.")
@click.option("--geotiff", is_flag=True, help="The image is a GeoTIFF with its own georeference.")
@click.option(
    "--worldfile", type=_FILE, is_flag=False, flag_value=_BESIDE, metavar="[FILE]",
    help="World file; without FILE the one next to the image.",
)  # fmt: skip
@click.option("--control-points", type=_FILE, metavar="FILE", help="Table x;y;lat;lon of known points.")
@click.option("--crs", metavar="CRS", help="Coordinate system of the world file or GeoTIFF: EPSG:32633 ...")
@click.option(
    "--model", type=click.Choice(["similarity", "affine", "projective"]),
    help="How control points are fitted; default: the most general that their number allows.",
)  # fmt: skip
@click.option("--blank", is_flag=True, help="Make a blank plan around the photos instead of an image.")
@click.option(
    "--positions", type=_FILE, metavar="FILE",
    help="Positions by file name instead of EXIF: .cfg, table, GeoJSON, KML, GeoPackage, GPX with waypoints.",
)  # fmt: skip
@click.option(
    "--columns", metavar="TEXT", help="Columns of a table of positions: name=File, lat=Latitude, lon=3 ..."
)
@click.option(
    "--panoramas", "assume", is_flag=True,
    help="Treat all photos twice as wide as high as panoramas, even without metadata.",
)  # fmt: skip
@click.option(
    "--mask", type=_FILE, metavar="IMAGE",
    help="Mask of the panoramas: nothing is recognised where it is black.",
)  # fmt: skip
@click.option(
    "--lowest", default=90.0, show_default=True, type=_ELEVATION, metavar="DEGREES",
    help="Mask everything farther below the horizon of panoramas.",
)  # fmt: skip
@click.option(
    "--highest", default=90.0, show_default=True, type=_ELEVATION, metavar="DEGREES",
    help="Mask everything farther above it: the sky.",
)  # fmt: skip
@click.option("--copy", is_flag=True, help="Copy photos and image from elsewhere into the map's folder.")
@click.option("--force", is_flag=True, help="Replace a map that exists; its photos keep their ids.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
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
    columns: str | None,
    assume: bool,
    mask: Path | None,
    lowest: float,
    highest: float,
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
        raise UsageError(f"{names} cannot be used together", hint="choose one of them")
    if columns and positions is None:
        raise UsageError("--columns needs a table of positions", where="--columns", hint="add --positions")
    if not kinds and (crs or model):
        raise UsageError("--crs and --model need a source of the georeference", hint="add one of them")
    around = map_from_photos.PanoramaOptions(assume, mask, lowest, highest)
    options = map_from_photos.PlaceOptions(
        cfg,
        satellite,
        next(iter(kinds), None),
        positions=positions,
        columns=columns,
        copy=copy,
        force=force,
        panoramas=around,
    )
    with terminal_progress("photos") as progress:
        report = map_from_photos.map_from_photos(
            folder, options=options, settings=settings_in_use(cfg), progress=progress
        )
    _show_warnings(report)
    click.echo(
        json.dumps(_report_as_json(report), indent=1, ensure_ascii=False)
        if as_json
        else _report_table(report)
    )
    if report.count(FileState.UNREADABLE) or not report.written:
        ctx.exit(SOME_FAILED)


def _show_warnings(report: map_from_photos.PlaceReport) -> None:
    """Print residuals and warnings, and whether no map was written, to standard error."""
    if report.residuals_m:
        metres = " ".join(significant(round(residual, 6)) for residual in report.residuals_m)
        click.echo(f"residuals of the control points, metres: {metres}", err=True)
    for warning in report.warnings:
        click.echo(f"warning: {warning}", err=True)
    if not report.written:
        click.echo("no photo could be placed: no map was written", err=True)


def _report_table(report: map_from_photos.PlaceReport) -> str:
    width = max((len(file.name) for file in report.files), default=0)
    lines = []
    for file in report.files:
        details = [file.reason] if file.reason else []
        if file.experience is not None:
            x, y = file.experience.position
            details.append(f"id {file.experience.id} at x {x:.1f}, y {y:.1f}")
        if file.position_from not in (None, "EXIF"):
            details.append(f"position from {file.position_from}")
        lines.append(f"{file.name:{width}}  {file.state:17}  {'; '.join((*details, *file.notes))}".rstrip())
    counts = ", ".join(f"{report.count(state)} {state}" for state in FileState)
    return "\n".join([*lines, f"{len(report.files)} files: {counts}"])


def _report_as_json(report: map_from_photos.PlaceReport) -> dict[str, object]:
    image = report.satellite
    return {
        "map": str(report.cfg) if report.written else None,
        "satellite": image and {"path": image.path, "width": image.width, "height": image.height},
        "counts": {str(state): report.count(state) for state in FileState},
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
        "position_from": file.position_from,
        "notes": list(file.notes),
    }


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
