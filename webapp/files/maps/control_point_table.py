"""Control points as a table or as ODM's `gcp_list.txt`: a row for each click, with the data of its point."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from webapp.core.geo.crs import latlon_from_plane
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.control_points import TAG_MOUNTS, Tag
from webapp.errors import TableError
from webapp.files.maps.position_tables import odm_plane
from webapp.files.text_file import (
    cell_text,
    delimiter_of,
    numbered_lines,
    plain_cell,
    read_bytes,
    split_row,
)

COLUMNS = (
    "name",
    "x_px",
    "y_px",
    "lat",
    "lon",
    "height_m",
    "accuracy_m",
    "tag",
    "tag_size_mm",
    "tag_mount",
    "tag_heading_deg",
    "check",
    "photo",
    "photo_x_px",
    "photo_y_px",
)
_ODM_CELLS, _MOST_DIGITS = 6, 6
_TEXTS = ("name", "tag", "tag_mount", "check", "photo")
_YES_NO: Mapping[str, bool | None] = {
    "": None, "yes": True, "true": True, "1": True, "no": False, "false": False, "0": False
}  # fmt: skip
_PAIRS = (("x_px", "y_px"), ("lat", "lon"), ("photo_x_px", "photo_y_px"))


@dataclass(frozen=True, slots=True)
class PointRow:
    """A row of the table; empty cells are None."""

    name: str
    where: str  # File and line
    position: MapPixel | LatLon | None = None
    height_m: float | None = None
    accuracy_m: float | None = None
    photo: str | None = None  # Path or file name
    click_px: tuple[float, float] | None = None  # Pixels from the top-left corner of the upright photo
    tag: Tag | None = None
    is_check: bool | None = None  # Whether it is a check point


def read_rows(path: Path) -> list[PointRow]:
    """Read a table with any delimiter, whose first line names the columns, in any order; or ODM's list."""
    data = read_bytes(path, error=TableError)
    lines = [(f"{path}:{n}", line) for n, line in numbered_lines(io.BytesIO(data)) if line.strip()]
    if not lines:
        raise TableError("the file is empty", where=str(path), hint=f"the columns are {', '.join(COLUMNS)}")
    plane = odm_plane(lines[0][1], lines[0][0])
    if plane is not None:
        return _odm_rows(lines[1:], plane)
    delimiter = delimiter_of(lines[0][1]) or ";"
    header = [cell.strip().lower() for cell in split_row(lines[0][1], delimiter)]
    unknown = [cell for cell in header if cell not in COLUMNS]
    if unknown or "name" not in header or len(set(header)) < len(header):
        problem = (
            f"has an unknown column {unknown[0][:40]!r}" if unknown else "has no column name, or one twice"
        )
        raise TableError(
            f"the first line {problem}", where=lines[0][0], hint=f"the columns are {', '.join(COLUMNS)}"
        )
    return [
        _row(dict(zip(header, split_row(line, delimiter), strict=False)), where) for where, line in lines[1:]
    ]


def _odm_rows(lines: Sequence[tuple[str, str]], plane: str) -> list[PointRow]:
    """Read ODM's list: x, y, z, pixel x, pixel y, photo and optionally the point's name.

    Points without a name are distinguished by their coordinates.
    """
    cells = [(where, line.split()) for where, line in lines if not line.lstrip().startswith("#")]
    for where, row in cells:
        if len(row) < _ODM_CELLS:
            hint = "write: x y z pixel_x pixel_y photo [name]"
            raise TableError("a line has too few columns", where=where, hint=hint)
    numbers = [[_needed(text, where) for text in row[: _ODM_CELLS - 1]] for where, row in cells]
    found = latlon_from_plane(plane, [row[:2] for row in numbers]).tolist()
    names: dict[tuple[float, ...], str] = {}
    rows = []
    for (where, row), (x, y, z, *click), (lat, lon) in zip(cells, numbers, found, strict=True):
        if not math.isfinite(lat):
            raise TableError(f"the position is outside {plane[:40]}", where=where)
        unnamed = names.setdefault((x, y, z), f"GCP {len(names) + 1}")
        name = row[_ODM_CELLS] if len(row) > _ODM_CELLS else unnamed
        photo = row[_ODM_CELLS - 1]
        rows.append(PointRow(name, where, LatLon(lat, lon), z, None, photo, (click[0], click[1])))
    return rows


def _needed(text: str, where: str) -> float:
    value = _number(text, where)
    if value is None:
        raise TableError("a number is missing", where=where)
    return value


def _row(cells: Mapping[str, str], where: str) -> PointRow:
    texts = {name: cell_text(cell.strip()) for name, cell in cells.items()}
    values = {name: _number(texts.get(name, ""), where) for name in COLUMNS if name not in _TEXTS}
    for one, other in _PAIRS:
        if (values[one] is None) != (values[other] is None):
            raise TableError(
                f"the row has only one of {one} and {other}", where=where, hint="give both or none"
            )
    pixel, degrees, click = (
        None if a is None or b is None else (a, b) for a, b in ((values[a], values[b]) for a, b in _PAIRS)
    )
    if not texts.get("name"):
        raise TableError("the row has no name", where=where)
    if (click is None) != (not texts.get("photo")):
        raise TableError("a click needs photo, photo_x_px and photo_y_px", where=where)
    return PointRow(
        texts["name"],
        where,
        MapPixel(*pixel) if pixel is not None else None if degrees is None else LatLon(*degrees),
        values["height_m"],
        values["accuracy_m"],
        texts.get("photo") or None,
        click,
        _tag(texts, values["tag_size_mm"], values["tag_heading_deg"], where=where),
        _yes_or_no(texts.get("check", ""), where),
    )


def _yes_or_no(text: str, where: str) -> bool | None:
    try:
        return _YES_NO[text.lower()]
    except KeyError:
        raise TableError(f"check is not yes or no: {text[:40]!r}", where=where) from None


def _tag(
    texts: Mapping[str, str], size_mm: float | None, heading_deg: float | None, *, where: str
) -> Tag | None:
    """Read the columns of a tag: family and id, side in millimetres, mount, heading."""
    title = texts.get("tag", "").split()
    mount = texts.get("tag_mount", "").lower() or "wall"
    if not title and size_mm is None:
        return None
    if len(title) != 2 or not title[1].isdigit() or len(title[1]) > _MOST_DIGITS or size_mm is None:
        hint = "write family and id, such as 36h11 3, and the side of its black square"
        raise TableError("a tag needs tag and tag_size_mm", where=where, hint=hint)
    if mount not in TAG_MOUNTS:
        raise TableError(f"tag_mount is not wall or floor: {mount[:40]!r}", where=where)
    return Tag(title[0], int(title[1]), size_mm, mount, heading_deg)


def _number(text: str, where: str) -> float | None:
    if not text:
        return None
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TableError(f"{text[:40]!r} is not a number", where=where, hint="write a plain number")
    return value


def format_rows(rows: Iterable[PointRow], latlon: Mapping[str, LatLon]) -> str:
    """Write a table; `latlon` has the latitudes and longitudes of points, by name."""
    out = io.StringIO()
    writer = csv.writer(out, delimiter=";", lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        at = row.position or ("", "")
        degrees = [f"{value:.8f}" for value in latlon[row.name]] if row.name in latlon else ["", ""]
        facts = ["" if value is None else value for value in (row.height_m, row.accuracy_m)]
        click = ("", "") if row.click_px is None else [f"{value:.2f}" for value in row.click_px]
        photo = plain_cell(row.photo or "")
        own = [*_tag_cells(row.tag), "yes" if row.is_check else ""]
        writer.writerow([plain_cell(row.name), *at, *degrees, *facts, *own, photo, *click])
    return out.getvalue()


def _tag_cells(tag: Tag | None) -> tuple[object, ...]:
    if tag is None:
        return ("", "", "", "")
    return (tag.title, tag.size_mm, tag.mount, "" if tag.heading_deg is None else tag.heading_deg)
