"""Positions of photos by file name: from a `.cfg`, or a table `name;lat;lon` or `name;x;y`.

A table may have headings in a fourth column, `heading_deg`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from webapp.core.geo.fit import check_positions
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError, TableError
from webapp.files.maps.cfg import read_cfg
from webapp.files.text_file import TextRow, read_table

_LATLON, _PIXEL = "name;lat;lon", "name;x;y"
_HEADING = ";heading_deg"
_HEADERS = (_LATLON, _PIXEL, _LATLON + _HEADING, _PIXEL + _HEADING)


@dataclass(frozen=True, slots=True)
class Positions:
    """Positions of photos, by the name that the list gives them.

    Attributes
    ----------
    by_name : mapping of str to LatLon or MapPixel
        Paths with forward slashes; all values of one kind.
    image_size : tuple of int or None
        Of the image that pixels are on (from a `.cfg`); None for degrees and where it is unknown.
    headings_deg : mapping of str to float
        Degrees clockwise from north, where the list has them.
    """

    by_name: Mapping[str, LatLon | MapPixel]
    image_size: tuple[int, int] | None = None
    headings_deg: Mapping[str, float] = field(default_factory=dict)

    @property
    def in_pixels(self) -> bool:
        """Whether they are map pixels, not degrees."""
        return any(isinstance(position, MapPixel) for position in self.by_name.values())

    def find(self, name: str) -> LatLon | MapPixel | None:
        """Find a photo by its path, or else by its file name where only one entry has that.

        Parameters
        ----------
        name : str
            Path with forward slashes.
        """
        entry = self._entry(name)
        return None if entry is None else self.by_name[entry]

    def heading_of(self, name: str) -> float | None:
        """Find where a photo looks, as `find` does; None where the list does not say."""
        return self.headings_deg.get(self._entry(name) or "")

    def _entry(self, name: str) -> str | None:
        if name in self.by_name:
            return name
        last = PurePosixPath(name).name
        same = [key for key in self.by_name if PurePosixPath(key).name == last]
        return same[0] if len(same) == 1 else None


def read_positions(path: Path) -> Positions:
    """Read a list of positions.

    Parameters
    ----------
    path : Path
        A `.cfg`, or a semicolon table with the header `name;lat;lon` or `name;x;y`, perhaps with
        `;heading_deg` behind it (empty: not known).

    Raises
    ------
    TableError
        The table breaks the format, with the line; or it names a photo twice.
    MapError
        The `.cfg` breaks its format.
    """
    if path.suffix.lower() == ".cfg":
        map_ = read_cfg(path).map
        size = (map_.satellite.width, map_.satellite.height)
        return Positions({e.photo: e.position for e in map_.experiences}, size)
    header, rows = read_table(path, headers=_HEADERS)
    names = [row.fields[0].strip().replace("\\", "/") for row in rows]
    twice = Counter(names).most_common(1)
    if twice and twice[0][1] > 1:
        where = rows[len(names) - 1 - names[::-1].index(twice[0][0])].where
        raise TableError(
            f"the photo {twice[0][0]!r} is listed twice", where=where, hint="keep one of the lines"
        )
    kind = _latlon if header.startswith(_LATLON) else _pixel
    positions = {name: kind(row) for name, row in zip(names, rows, strict=True)}
    turned = [(name, row) for name, row in zip(names, rows, strict=True) if any(row.fields[3:])]
    return Positions(positions, headings_deg={name: _heading(row) for name, row in turned})


def _heading(row: TextRow) -> float:
    heading = row.number(3)
    if not 0.0 <= heading <= 360.0:
        raise TableError(f"the heading {heading:g} is not from 0 to 360", where=row.where)
    return heading % 360.0


def _latlon(row: TextRow) -> LatLon:
    position = LatLon(row.number(1), row.number(2))
    try:
        check_positions([position])
    except GeoreferenceError as error:
        raise TableError(error.message, where=row.where, hint=error.hint) from error
    return position


def _pixel(row: TextRow) -> MapPixel:
    return MapPixel(row.number(1), row.number(2))
