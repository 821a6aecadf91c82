"""The EXIF tags of a photo as plain tables, whatever state they are in."""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import piexif
from PIL import Image

from webapp.files.decode import DAMAGED

_CAMERA_IFD = 0x8769
_GPS_IFD = 0x8825
_ORIENTATION = 0x0112
_INTEROP_IFD = 0xA005
_POINTERS = {_CAMERA_IFD, _GPS_IFD, _INTEROP_IFD}
_TABLES = ("0th", "Exif", "GPS")
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
"""Bytes of one value of each type of TIFF 6.0."""


@dataclass(frozen=True, slots=True)
class Exif:
    """Tag number -> value of the three tables that matter; empty where there is none.

    Attributes
    ----------
    image, camera, gps : mapping of int to object
        IFD 0, the Exif IFD and the GPS IFD. Values may be of any type.
    notes : tuple of str
        What was damaged, in sentences.
    """

    image: Mapping[int, object] = field(default_factory=dict)
    camera: Mapping[int, object] = field(default_factory=dict)
    gps: Mapping[int, object] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_exif(image: Image.Image) -> Exif:
    """Read the EXIF of an opened photo; a damaged part is empty and noted, never a failure.

    Pillow finds the block in whatever format the photo has, piexif parses it where it is well-formed. A block
    that is not, and one that is no block of its own (TIFF, texts of PNG), is read by Pillow, tag by tag.
    """
    raw = image.info.get("exif")
    tables = parse_block(raw) if isinstance(raw, bytes) else None
    if tables is None:
        return _read_tolerantly(image)
    if _ORIENTATION not in tables["0th"]:
        turned = _read_tolerantly(image).image.get(_ORIENTATION)  # Pillow takes it from XMP then
        if turned is not None:
            tables["0th"][_ORIENTATION] = turned
    first, camera, gps = (
        {tag: _plain(ifd, tag, value) for tag, value in tables[ifd].items()} for ifd in _TABLES
    )
    return Exif(first, camera, gps)


def parse_block(raw: bytes) -> dict[str, Any] | None:
    """Parse a well-formed EXIF block by piexif.

    Parameters
    ----------
    raw : bytes
        With `Exif\\0\\0` before its TIFF header, or without.

    Returns
    -------
    dict of str to dict, or None
        As `piexif.load` returns it; None for a block that is damaged, not safe to parse (piexif believes any
        length) or that piexif would misread, and for an empty one.
    """
    tiff = raw.removeprefix(b"Exif\0\0")
    try:
        if not _well_formed(tiff):
            return None
        tables: dict[str, Any] = piexif.load(b"Exif\0\0" + tiff)
    except (*DAMAGED, OSError):
        return None
    return tables if tables["0th"] else None


def _well_formed(tiff: bytes) -> bool:
    """Check that each value of each table is of a known type, inside the block, and each text has its end."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    if order is None:
        return False
    todo, seen = [struct.unpack_from(f"{order}L", tiff, 4)[0]], set()
    while todo:
        at = todo.pop()
        if at in seen:
            return False
        seen.add(at)
        (count,) = struct.unpack_from(f"{order}H", tiff, at)
        for entry in range(at + 2, at + 2 + 12 * count, 12):
            tag, kind, number_, value = struct.unpack_from(f"{order}HHLL", tiff, entry)
            size = _TYPE_BYTES.get(kind, 0) * number_
            begin = entry + 8 if size <= 4 else value
            if size == 0 or begin + size > len(tiff):
                return False
            if kind == piexif.TYPES.Ascii and tiff[begin + size - 1] != 0:
                return False
            if tag in _POINTERS:
                todo.append(value)
        if len(seen) == 1:  # only the first table is followed by another one, that of the thumbnail
            (following,) = struct.unpack_from(f"{order}L", tiff, at + 2 + 12 * count)
            todo += [following] if following else []
    return True


def _plain(ifd: str, tag: int, value: object) -> object:
    """Turn piexif's value into a number, a text or a tuple: rationals are floats, 0/0 is NaN."""
    kind = piexif.TAGS["Image" if ifd == "0th" else ifd][tag]["type"]
    if kind == piexif.TYPES.Ascii and isinstance(value, bytes):
        return value.decode("latin-1")
    if kind not in (piexif.TYPES.Rational, piexif.TYPES.SRational) or not isinstance(value, tuple):
        return value
    if all(isinstance(part, tuple) for part in value):
        return tuple(_quotient(*part) for part in value)
    return _quotient(*value) if len(value) == 2 else value


def _quotient(numerator: int, denominator: int) -> float:
    return numerator / denominator if denominator else math.nan


def _read_tolerantly(image: Image.Image) -> Exif:
    notes: list[str] = []
    tables: list[Mapping[int, object]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of each odd tag
        try:
            exif = image.getexif()
            tables.append(dict(exif))
        except (*DAMAGED, OSError):
            return Exif(notes=("its EXIF is damaged and was left out",))
        if image.info.get("exif") and not tables[0]:
            notes.append("its EXIF is empty or damaged")
        for name, ifd in (("camera", _CAMERA_IFD), ("GPS", _GPS_IFD)):
            try:
                tables.append(dict(exif.get_ifd(ifd)))
            except (*DAMAGED, OSError):
                tables.append({})
                notes.append(f"the {name} part of its EXIF is damaged and was left out")
    return Exif(tables[0], tables[1], tables[2], tuple(notes))


def orientation(exif: Exif) -> tuple[int, str | None]:
    """How the stored pixels must be turned to be upright.

    Returns
    -------
    value : int
        1 to 8 as in EXIF; 1 (as stored) when absent or invalid.
    note : str or None
        That it was invalid.
    """
    value = exif.image.get(_ORIENTATION)
    if value is None:
        return 1, None
    if isinstance(value, int) and 1 <= value <= 8:
        return value, None
    return 1, f"its EXIF orientation {str(value)[:20]!r} is none of 1 to 8; the photo is taken as stored"


def number(value: object) -> float | None:
    """Give a finite number, or None for anything else (0/0, text, a list)."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        result = float(value)
    except (ZeroDivisionError, OverflowError, ValueError):
        return None
    return result if math.isfinite(result) else None


def text(value: object) -> str:
    """Give a text without what cameras pad it with; empty for anything else."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.strip("\0 \t\r\n") if isinstance(value, str) else ""
