"""Meaning of a table's columns: given by the user, or guessed from its header.

Written as `time=stamp:ms, lat=Latitude, lon=Longitude, heading=yaw:rad`: a field, the column by its header or
by its number from 1, and a unit if it is not the default.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from webapp.errors import TrackError, UsageError

_DEG = math.degrees(1.0)
EXCEL_DAYS = 86400.0
"""Scale of a time in days since 1899-12-30, as in spreadsheets."""

DATE_ORDERS = {"ymd": 1.0, "dmy": 2.0, "mdy": 3.0}
"""Orders of year, month and day in a date: units of its column, and the scales that encode them."""

_ANGLE = {"deg": 1.0, "rad": _DEG, "e7": 1e-7, "e6": 1e-6}
_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "excel": EXCEL_DAYS},
    "date": {"": 0.0, **DATE_ORDERS},
    "lat": _ANGLE,
    "lon": _ANGLE,
    "lat_ref": {"": 1.0},
    "lon_ref": {"": 1.0},
    "height": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048},
    "heading": {"deg": 1.0, "rad": _DEG, "cdeg": 1e-2},
    "yaw": {"rad": 1.0, "deg": 1.0 / _DEG},
    "x": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "y": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "z": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "qx": {"1": 1.0},
    "qy": {"1": 1.0},
    "qz": {"1": 1.0},
    "qw": {"1": 1.0},
    "valid": {"": 1.0},
    "var_e": {"m2": 1.0},
    "var_n": {"m2": 1.0},
    "cov_en": {"m2": 1.0},
    "accuracy": {"m": 1.0, "mm": 1e-3},
    "confidence": {"1": 1.0, "%": 1e-2},
    "id": {"": 1.0},
    "class": {"": 1.0},
    "track": {"": 1.0},
    "source": {"": 1.0},
}
"""Fields and their permitted units, the default first; text fields have none. A time may also be in ISO 8601.
`heading` is clockwise from north, `yaw` counter-clockwise from x; `accuracy` is one standard deviation in
each direction. `lat_ref` and `lon_ref` contain N or S and E or W if the numbers have no sign; `qx` to `qw`
are the orientation of the body."""

_NAMES: dict[str, Sequence[str]] = {
    "time": (
        "time",
        "timestamp",
        "timestamps",
        "stamp",
        "t",
        "utc",
        "datetime",
        "date_time",
        "unixtime",
        "times",
        "utc_t",
        "utc_time",
        "gps_time",
        "local_time",
        "frame_id",
    ),
    "date": ("date", "utc_d", "utc_date", "gps_date", "local_date"),
    "lat": ("lat", "latitude", "gps_lat", "gpslatitude", "breite", "latitude_n/s"),
    "lon": ("lon", "lng", "long", "longitude", "gps_lon", "gpslongitude", "longitude_e/w"),
    "lat_ref": ("n/s", "ns", "n_s", "lat_ref", "latitude_ref", "gpslatituderef", "lat_dir"),
    "lon_ref": ("e/w", "ew", "e_w", "lon_ref", "longitude_ref", "gpslongituderef", "lon_dir"),
    "height": ("height", "alt", "altitude", "ele", "elevation"),
    "heading": ("heading", "hdg", "course", "bearing", "azimuth", "cog"),
    "yaw": ("yaw", "theta"),
    "x": ("x", "tx", "pos_x", "position_x", "translation_x", "p_x", "p_rs_r_x"),
    "y": ("y", "ty", "pos_y", "position_y", "translation_y", "p_y", "p_rs_r_y"),
    "z": ("z", "tz", "pos_z", "position_z", "translation_z", "p_z", "p_rs_r_z"),
    **{
        f"q{axis}": (
            f"q{axis}",
            f"q_{axis}",
            f"quaternion_{axis}",
            f"quat_{axis}",
            f"orientation_{axis}",
            f"rotation_{axis}",
            f"rot_{axis}",
            f"q_rs_{axis}",
        )
        for axis in "xyzw"
    },
    "valid": ("valid", "fix_mode", "fix", "fix_type"),
    "var_e": ("var_e",),
    "var_n": ("var_n",),
    "cov_en": ("cov_en",),
    "accuracy": ("accuracy", "hacc", "horizontal_accuracy"),
    "confidence": ("confidence", "score"),
    "id": ("id", "object_id", "object"),
    "class": ("class", "kind", "type", "label"),
    "track": ("track",),
    "source": ("source",),
}
_PHOTO_UNITS: dict[str, dict[str, float]] = {
    "name": {"": 1.0},
    "lat": _UNITS["lat"],
    "lon": _UNITS["lon"],
    "lat_ref": {"": 1.0},
    "lon_ref": {"": 1.0},
    "x": {"px": 1.0},
    "y": {"px": 1.0},
    "heading": _UNITS["heading"],
}
"""`lat_ref` and `lon_ref` contain N or S and E or W if the numbers have no sign."""

_PHOTO_NAMES: dict[str, Sequence[str]] = {
    "name": (
        "name",
        "photo",
        "photo_name",
        "file",
        "filename",
        "file_name",
        "sourcefile",
        "source_file",
        "path",
        "image",
        "image_name",
        "img",
        "picture",
        "title",
    ),
    "lat": _NAMES["lat"],
    "lon": _NAMES["lon"],
    "lat_ref": ("lat_ref", "gpslatituderef"),
    "lon_ref": ("lon_ref", "gpslongituderef"),
    "x": ("x", "px", "pixel_x", "column"),
    "y": ("y", "py", "pixel_y", "row"),
    "heading": (*_NAMES["heading"], "yaw", "direction", "gpsimgdirection"),
}


@dataclass(frozen=True, slots=True)
class ColumnFields:
    """The fields of a kind of table."""

    units: Mapping[str, Mapping[str, float]]  # The units of each field
    # Headers by which each field is recognised: lower case, words joined by `_`.
    names: Mapping[str, Sequence[str]]
    needed: tuple[str, ...]  # Fields that are required in addition to a position
    example: str  # Example of how columns are written


POSE_FIELDS = ColumnFields(_UNITS, _NAMES, (), "time=stamp:ms, lat=Latitude, lon=Longitude")
"""Poses and objects of a mission."""

PHOTO_FIELDS = ColumnFields(_PHOTO_UNITS, _PHOTO_NAMES, ("name",), "name=File, lat=Latitude, lon=Longitude")
"""Positions of photos, on the Earth or in pixels of the satellite image."""

_UNIT_WORDS = {
    "seconds": "s",
    "sec": "s",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "degrees": "deg",
    "radians": "rad",
    "metres": "m",
    "meters": "m",
    "feet": "ft",
    "pixels": "px",
    "°": "deg",
}
_PART = re.compile(r"\s*([a-z_]+)\s*=\s*(.+?)\s*(?::\s*([a-z0-9%]+)\s*)?", re.IGNORECASE)
_WITH_UNIT = re.compile(
    r"(.+?)[\s_]*(?:[\[(]\s*([a-z0-9%°]*)\s*[\])]|[_\s](s|ms|us|ns|m|m2|mm|cm|ft|deg|rad|e7|px))"
)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    index: int  # From 0
    scale: float  # Factor that converts its numbers to the field's default unit


Columns = Mapping[str, Column]


def parse_columns(text: str, header: Sequence[str], *, fields: ColumnFields = POSE_FIELDS) -> Columns:
    """Parse the user's assignment of columns to fields.

    Args:
        text: Fields separated by commas, as described above.
        header: The table's first line; names are compared without regard to case.
        fields: Fields that the table can have.

    Raises:
        UsageError: A field, a unit or a column is unknown, or positions are missing.
    """
    names = [name.strip().lstrip("#%").strip().lower() for name in header]
    found: dict[str, Column] = {}
    for part in text.split(","):
        written = _PART.fullmatch(part)
        field = written[1].lower() if written else ""
        if written is None or field not in fields.units:
            hint = f"write it like {fields.example}; fields are {', '.join(fields.units)}"
            raise UsageError(
                f"{part.strip()[:60]!r} is not a field of this table", where="columns", hint=hint
            )
        name, unit = written[2], written[3]
        index = _place(name, names)
        if index is None and unit is not None:  # the header itself contains the colon
            index, unit = _place(f"{name}:{unit}", names), None
        if index is None:
            hint = f"its columns are {', '.join(header)[:200]}; numbers count from 1"
            raise UsageError(f"the table has no column {name[:40]!r}", where="columns", hint=hint)
        found[field] = Column(index, _scale(field, unit, units=fields.units[field]))
    problem = _missing(found, fields)
    if 0 < sum(f"q{axis}" in found for axis in "xyzw") < len("xyzw"):
        problem = "the quaternion is incomplete"
    if problem:
        raise UsageError(problem, where="columns", hint=f"write them like {fields.example}")
    return found


def guess_columns(header: Sequence[str], *, fields: ColumnFields = POSE_FIELDS) -> Columns:
    """Guess the columns' fields from the header: `timestamp_ms`, `Latitude [deg]`, `x (m)` ...

    Raises:
        TrackError: No columns for a position or another required field are recognised.
    """
    found: dict[str, Column] = {}
    for index, name in enumerate(header):
        plain = name.strip().lstrip("#%").strip().lower()
        field, unit = _recognized(plain, fields), None
        with_unit = _WITH_UNIT.fullmatch(plain)
        if field is None and with_unit is not None:
            field, unit = _recognized(with_unit[1], fields), with_unit[2] or with_unit[3]
        if field is not None and field not in found:
            unit = _UNIT_WORDS.get(unit, unit) if unit else None
            units = fields.units[field]
            found[field] = Column(index, units.get(unit or "", _scale(field, None, units=units)))
    if _missing(found, fields):
        hint = f"assign columns to fields, such as {fields.example}"
        what = " and ".join((*(f"{field}s" for field in fields.needed), "positions"))
        raise TrackError(f"no columns of {what} are recognised in {', '.join(header)[:100]!r}", hint=hint)
    return found


def _recognized(name: str, fields: ColumnFields) -> str | None:
    word = re.sub(r"[\s.\-]+", "_", name.strip())
    return next((field for field, names in fields.names.items() if word in names), None)


def _place(name: str, names: Sequence[str]) -> int | None:
    wanted = name.strip().strip("'\"").lower()
    if wanted in names:
        return names.index(wanted)
    if wanted.isascii() and wanted.isdecimal() and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    return None


def _scale(field: str, unit: str | None, *, units: Mapping[str, float]) -> float:
    if unit is None:
        return next(iter(units.values()))
    if unit.lower() not in units:
        raise UsageError(
            f"{field} has no unit {unit!r}",
            where="columns",
            hint=f"permitted units: {', '.join(filter(None, units)) or 'none'}",
        )
    return units[unit.lower()]


def _missing(found: Columns, fields: ColumnFields) -> str | None:
    needed = next((field for field in fields.needed if field not in found), None)
    if needed is not None:
        return f"no column holds a {needed}"
    if ("lat" in found) != ("lon" in found) or ("x" in found) != ("y" in found):
        return "only one of the two coordinates has a column"
    return None if "lat" in found or "x" in found else "no column holds a position"
