"""Control points of a satellite image: a table `x;y;lat;lon`, map pixels and degrees, one point a line."""

from __future__ import annotations

from pathlib import Path

from webapp.core.geo.controlpoints import ControlPoint
from webapp.core.geo.fit import check_positions
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError, TableError
from webapp.files.text_file import Row, read_table

HEADER = "x;y;lat;lon"


def read_control_points(path: Path) -> list[ControlPoint]:
    """Read control points.

    Parameters
    ----------
    path : Path
        Semicolon table with the header `x;y;lat;lon`: pixels right of and below the image's outer top-left
        corner, degrees north and east.

    Returns
    -------
    list of ControlPoint
        At least one.

    Raises
    ------
    TableError
        The file cannot be read or breaks the format, with the line.
    """
    _, rows = read_table(path, headers=[HEADER])
    if not rows:
        raise TableError("there is no control point", where=str(path), hint=f"add one a line: {HEADER}")
    return [_point(row) for row in rows]


def _point(row: Row) -> ControlPoint:
    x, y, lat, lon = (row.number(column) for column in range(4))
    position = LatLon(lat, lon)
    try:
        check_positions([position])
    except GeoreferenceError as error:
        raise TableError(error.message, where=row.where, hint=error.hint) from error
    return ControlPoint(MapPixel(x, y), position)
