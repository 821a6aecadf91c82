"""World files: six numbers beside an image, and perhaps a `.prj` with the coordinate system."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from webapp.core.geo.crs import WGS84, crs_name
from webapp.core.geo.fit import Fit, check_on_image
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.pixelgrid import homography_for_corners
from webapp.errors import GeoreferenceError
from webapp.files.text_file import read_text

_HINT = "a world file has six lines: x size, rotation, rotation, -y size, x and y of the first pixel's centre"


def find_worldfile(image: Path) -> Path:
    """Find the world file of an image: `.pgw`, `.pngw` or `.wld` for a `.png`, and so on, in any letter case.

    Raises
    ------
    GeoreferenceError
        There is none.
    """
    ending = image.suffix[1:].lower()
    endings = [f".{ending[:1]}{ending[-1:]}w", f".{ending}w", ".wld"]
    names = [f"{image.stem}{e}" for e in endings] + [f"{image.name}w", f"{image.name}.wld"]
    beside = {p.name.lower(): p for p in sorted(image.parent.iterdir())} if image.parent.is_dir() else {}
    for name in names:
        if name.lower() in beside:
            return beside[name.lower()]
    raise GeoreferenceError(
        "the image has no world file beside it",
        where=str(image),
        hint=f"add {names[0]}, or name the world file",
    )


def read_worldfile(path: Path, *, width: int, height: int, crs: str | None = None) -> Fit:
    """Read a world file.

    Parameters
    ----------
    width, height : int
        Of the image, pixels.
    crs : str, optional
        Coordinate system of the numbers. Default: the one of the `.prj` beside it, else EPSG:4326 (degrees
        of longitude and latitude), if the numbers can be that.

    Returns
    -------
    Fit
        Without residuals.

    Raises
    ------
    GeoreferenceError
        It cannot be read, does not hold six numbers, has no plausible coordinate system, or shows the Earth
        mirrored.
    """
    text = read_text(path, error=GeoreferenceError)
    return parse_worldfile(text, where=str(path), width=width, height=height, crs=crs or _beside(path))


def parse_worldfile(text: str, *, where: str, width: int, height: int, crs: str | None = None) -> Fit:
    """Read the content of a world file; see `read_worldfile`.

    Parameters
    ----------
    where : str
        Name of the file, for errors.
    width, height : int
        Of the image, pixels.
    crs : str, optional
        Default: EPSG:4326, if the numbers can be that.
    """
    a, d, b, e, c, f = _six_numbers(text, where)
    centres = np.array([[a, b, c], [d, e, f], [0.0, 0.0, 1.0]])
    matrix = homography_for_corners(centres)
    plane = crs_name(crs) if crs else None
    if plane is None:
        _check_degrees(matrix, where, width=width, height=height)
        plane = WGS84
    try:
        georeference = Georeference(plane, tuple(float(v) for v in matrix.ravel()), "worldfile")
        check_on_image(georeference, width=width, height=height)
    except GeoreferenceError as error:
        raise GeoreferenceError(error.message, where=where, hint=error.hint or _HINT) from error
    return Fit(georeference)


def _six_numbers(text: str, where: str) -> list[float]:
    lines = text.split()
    try:
        # some programs of some countries write decimal commas here
        numbers = [float(line.replace(",", ".")) for line in lines]
    except ValueError as error:
        raise GeoreferenceError("a line is not a number", where=where, hint=_HINT) from error
    if len(numbers) != 6 or not all(math.isfinite(n) for n in numbers):
        raise GeoreferenceError(f"it holds {len(numbers)} numbers, not 6", where=where, hint=_HINT)
    return numbers


def _beside(path: Path) -> str | None:
    for ending in (".prj", ".PRJ"):
        prj = path.with_suffix(ending)
        if prj.is_file():
            try:
                return crs_name(read_text(prj, error=GeoreferenceError).strip())
            except GeoreferenceError as error:
                raise GeoreferenceError(error.message, where=str(prj), hint=error.hint) from error
    return None


def _check_degrees(matrix: np.ndarray, where: str, *, width: int, height: int) -> None:
    corners = np.array([(0, 0, 1), (width, 0, 1), (width, height, 1), (0, height, 1)], dtype=np.float64)
    x, y = (corners @ matrix.T)[:, :2].T
    if (np.abs(x) > 180.0).any() or (np.abs(y) > 90.0).any():
        raise GeoreferenceError(
            "its numbers are not degrees of longitude and latitude",
            where=where,
            hint="give the coordinate system, such as --crs EPSG:32633",
        )
