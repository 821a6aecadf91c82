"""Corners of a satellite image: JSON with `top_left` and `bottom_right`, or all four, each `{lat, lon}`."""

from __future__ import annotations

from pathlib import Path

from webapp.core.geo.corners import Corners
from webapp.core.geo.types import LatLon
from webapp.errors import GeoreferenceError, MapJsonError
from webapp.files.json_fields import JsonField, finite, parse_json
from webapp.files.text_file import read_bytes

_EXAMPLE = '{"top_left": {"lat": 60.4055, "lon": 22.4676}, "bottom_right": {"lat": 60.4039, "lon": 22.4712}}'


def read_corners(path: Path) -> Corners:
    """Read a corners file.

    Beside the corners it may hold a `note`; nothing else.

    Raises
    ------
    GeoreferenceError
        With the JSON path of the field, or line and column where it is no JSON at all.
    """
    return parse_corners(read_bytes(path, error=GeoreferenceError), where=str(path))


def parse_corners(data: bytes, *, where: str = "corners") -> Corners:
    """Read the content of a corners file; see `read_corners`."""
    try:
        fields = parse_json(data, where=where).record(
            required=("top_left", "bottom_right"), optional=("top_right", "bottom_left", "note")
        )
        return Corners(
            top_left=_position(fields["top_left"]),
            bottom_right=_position(fields["bottom_right"]),
            top_right=_optional(fields["top_right"]),
            bottom_left=_optional(fields["bottom_left"]),
        )
    except MapJsonError as error:
        hint = error.hint if error.hint and error.hint != "restore the file" else f"write it like {_EXAMPLE}"
        raise GeoreferenceError(error.message, where=error.where, hint=hint) from error


def _optional(field: JsonField) -> LatLon | None:
    return None if field.missing else _position(field)


def _position(field: JsonField) -> LatLon:
    fields = field.record(required=("lat", "lon"))
    # the range is checked with the rest of the geometry, where a swap can be suspected
    return LatLon(
        *(fields[name].number("a finite number of degrees", valid=finite) for name in ("lat", "lon"))
    )
