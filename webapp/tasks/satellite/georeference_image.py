"""The georeference of a satellite image, from whichever source the user has."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from webapp.core.geo.controlpoints import Model, from_control_points
from webapp.core.geo.corners import from_corners
from webapp.core.geo.fit import GeoreferenceFit
from webapp.errors import GeoreferenceError, UsageError
from webapp.files.satellite.georeference_files import (
    find_worldfile,
    read_control_points,
    read_corners,
    read_geotiff,
    read_worldfile,
)


@dataclass(frozen=True, slots=True)
class GeoSource:
    """Where the georeference comes from.

    Attributes
    ----------
    kind : {"corners", "geotiff", "worldfile", "control-points"}
    file : Path or None
        Needed for corners and control points; a world file is looked for beside the image, a GeoTIFF is it.
    crs : str or None
        Coordinate system of a world file or GeoTIFF that does not state it.
    model : {"similarity", "affine", "projective"} or None
        For control points; None takes the richest that their number allows.
    """

    kind: Literal["corners", "geotiff", "worldfile", "control-points"]
    file: Path | None = None
    crs: str | None = None
    model: Model | None = None


def georeference_image(image: Path, source: GeoSource, *, width: int, height: int) -> GeoreferenceFit:
    """Make the georeference of an image.

    Parameters
    ----------
    width, height : int
        Of the image, pixels.

    Raises
    ------
    GeoreferenceError, TableError
        The source gives none; `where` names its file.
    UsageError
        A coordinate system or a model for a source that has its own, or a file is missing.
    """
    if source.crs and source.kind not in ("worldfile", "geotiff"):
        message = f"{source.kind} are always degrees on WGS 84"
        raise UsageError(message, where="--crs", hint="leave the option out")
    if source.model and source.kind != "control-points":
        raise UsageError("only control points are fitted", where="--model", hint="leave the option out")
    if source.kind == "geotiff":
        return read_geotiff(image, crs=source.crs)
    if source.kind == "worldfile":
        file = source.file or find_worldfile(image)
        return read_worldfile(file, width=width, height=height, crs=source.crs)
    if source.file is None:
        raise UsageError(f"{source.kind} need a file")
    try:
        if source.kind == "corners":
            return from_corners(read_corners(source.file), width=width, height=height)
        points = read_control_points(source.file)
        return from_control_points(points, width=width, height=height, model=source.model)
    except GeoreferenceError as error:
        raise GeoreferenceError(
            error.message, where=error.where or str(source.file), hint=error.hint
        ) from error
