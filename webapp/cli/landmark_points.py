"""`expmap landmarks points`: list, import, export and remove the control points of a map."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.options import MAP_FILE
from webapp.core.mapmodel.control_points import GroundControlPoint
from webapp.core.mapmodel.model import Map
from webapp.files.atomic import write_text
from webapp.files.maps.control_point_table import read_rows
from webapp.files.maps.folder import read_map
from webapp.files.maps.lists import point_fields
from webapp.tasks.landmarks.accept import library_of, owner_of
from webapp.tasks.landmarks.accuracy import Rmse, accuracy_fields, accuracy_of, residual_fields
from webapp.tasks.landmarks.control_points import Residual, stored_residuals
from webapp.tasks.landmarks.edit_points import (
    photo_sizes,
    points_from,
    set_in_folder,
    set_in_library,
    table_of,
    with_checks,
)
from webapp.tasks.maps import export


@click.command(short_help="List, read or write the control points of a map.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option(
    "--import", "table", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="Add the points of a table (CSV), replacing those with the same name.",
)  # fmt: skip
@click.option("--remove", multiple=True, metavar="NAME", help="Remove a point; may be repeated.")
@click.option(
    "--check", multiple=True, metavar="NAME",
    help="Make a point a check point: it is left out of every fit, and shows how accurate it is. May be "
    "repeated.",
)  # fmt: skip
@click.option(
    "--no-check", multiple=True, metavar="NAME", help="Use a check point for the fit again; may be repeated."
)
@click.option(
    "--export", "out", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Write all points to such a table.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def points(
    cfg: Path,
    table: Path | None,
    remove: tuple[str, ...],
    check: tuple[str, ...],
    no_check: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """List the control points of a map, the largest residual first.

    A control point is a real-world spot whose position on the map is known and which is clicked in two or
    more photos. Control points and placed photos together place the landmarks on the map. A table has one row
    per click: name, x_px and y_px on the map or lat and lon, height_m, accuracy_m, tag (family and
    id of a printed tag that is mounted there), tag_size_mm, tag_mount, tag_heading_deg, check (yes or no),
    photo, photo_x_px, photo_y_px.
    """
    settings = settings_in_use(cfg)
    with library_of(cfg, settings=settings) as there:
        the_map = read_map(cfg)
        size = photo_sizes(cfg, settings.photo)
        changes: dict[str, GroundControlPoint | None] = dict.fromkeys(remove)
        if table is not None:
            changes |= points_from(read_rows(table), the_map, size=size)
        changes |= with_checks(
            the_map, changes, checks=dict.fromkeys(no_check, False) | dict.fromkeys(check, True)
        )
        if changes and there is None:
            set_in_folder(cfg, changes)
        elif changes and there is not None:
            library, map_id = there
            set_in_library(library, map_id, points=changes, account_id=owner_of(library))
            export.export_map(library, map_id)
        the_map = read_map(cfg)
    if out is not None:
        write_text(out, table_of(the_map, size=size))
    found = stored_residuals(cfg, the_map)
    click.echo(json.dumps(_as_json(the_map, found), indent=1) if as_json else _table(the_map, found))


def _as_json(the_map: Map, found: Sequence[Residual] | None) -> dict[str, object]:
    points = [{"name": point.name, **point_fields(point)} for point in the_map.control_points]
    return {
        "points": points,
        "laid": found is not None,
        "residuals": [{**residual_fields(one, the_map), "error": one.problem} for one in found or ()],
        "accuracy": None if found is None else accuracy_fields(accuracy_of(found, the_map)),
    }


def _table(the_map: Map, found: Sequence[Residual] | None) -> str:
    if not the_map.control_points:
        return "the map has no control points"
    judged = {one.name: one for one in found or () if one.photo is None}
    names = [*judged, *(p.name for p in the_map.control_points if p.name not in judged)]
    points = {point.name: point for point in the_map.control_points}
    width = max(map(len, names))
    lines = [f"{name:{width}}  {_line(points[name], judged, the_map)}" for name in names]
    if found is None:
        lines.append("to see how well they fit, build the landmarks first: expmap landmarks build")
        return "\n".join(lines)
    accuracy = accuracy_of(found, the_map)
    each = ", each by all others" if accuracy.control.points else ""
    lines += _rmse_lines("control points", accuracy.control, note=each)
    lines += _rmse_lines("check points", accuracy.check)
    return "\n".join(lines)


def _rmse_lines(what: str, rmse: Rmse, note: str = "") -> Iterator[str]:
    if rmse.px is None or rmse.uncertainty is None:
        return
    length = f"{rmse.px:.1f} px" if rmse.m is None else f"{rmse.m:.3f} m"
    parts = [f"of {rmse.points}{note}"]
    if rmse.east_m is not None and rmse.north_m is not None:
        parts.append(f"{rmse.east_m:.3f} m east, {rmse.north_m:.3f} m north")
    if rmse.height_m is not None:
        parts.append(f"{rmse.height_m:.3f} m in height of {rmse.heights}")
    yield f"RMSE of {what}: {length} +- {100.0 * rmse.uncertainty:.0f} % ({'; '.join(parts)})"


def _line(point: GroundControlPoint, judged: Mapping[str, Residual], the_map: Map) -> str:
    at = "not on the map" if point.position is None else f"x {point.position.x:.1f}, y {point.position.y:.1f}"
    tag = "" if point.tag is None else f", tag {point.tag.title} of {point.tag.size_mm:g} mm"
    words = [f"{at}{tag}, clicked in {len(point.clicks)} photos"]
    one = judged.get(point.name)
    if one is None:
        return words[0]
    metres, pixels = one.residual_m(the_map), one.residual_px
    if point.is_check:
        words += ["check point", *_checked(one, the_map)]
    elif metres is not None:
        words.append(f"{metres:.2f} m off")
    elif pixels is not None:
        words.append(f"{pixels:.1f} px off")
    words += ["left out: the others agree on another place"] * one.contradicts
    words += [f"wrong click in {', '.join(one.wrong)}"] if one.wrong else []
    words += [one.problem] if one.problem else []
    return "; ".join(words)


def _checked(one: Residual, the_map: Map) -> Iterator[str]:
    shift, metres, sigma_m = (
        one.shift_m(the_map),
        one.residual_m(the_map),
        one.in_metres(one.sigma_px, the_map),
    )
    if shift is not None and metres is not None:
        yield f"{shift[0]:+.3f} m east, {shift[1]:+.3f} m north, {metres:.3f} m off"
    elif one.shift_px is not None and one.residual_px is not None:
        yield f"dx {one.shift_px[0]:+.1f}, dy {one.shift_px[1]:+.1f}, {one.residual_px:.1f} px off"
    else:
        return
    height = one.in_metres(one.height_off_px, the_map)
    if height is not None:
        yield f"{height:+.3f} m in height"
    sigma = f"{one.sigma_px or 0.0:.1f} px" if sigma_m is None else f"{sigma_m:.3f} m"
    yield f"seen in {one.photos} photos, itself accurate to {sigma}"
