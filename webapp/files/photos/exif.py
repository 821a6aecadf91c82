"""The EXIF tags of a photo as plain tables, whatever state they are in."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real

from PIL import Image

from webapp.files.decode import DAMAGED

_CAMERA_IFD = 0x8769
_GPS_IFD = 0x8825
_ORIENTATION = 0x0112


@dataclass(frozen=True, slots=True)
class Exif:
    """Tag number -> value of the three tables that matter; empty where there is none.

    Attributes
    ----------
    image, camera, gps : mapping of int to object
        IFD 0, the Exif IFD and the GPS IFD. Values are as Pillow gives them and may be of any type.
    notes : tuple of str
        What was damaged, in sentences.
    """

    image: Mapping[int, object] = field(default_factory=dict)
    camera: Mapping[int, object] = field(default_factory=dict)
    gps: Mapping[int, object] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_exif(image: Image.Image) -> Exif:
    """Read the EXIF of an opened photo; a damaged part is empty and noted, never a failure."""
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
