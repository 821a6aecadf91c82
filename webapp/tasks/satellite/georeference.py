"""The georeference of an image, from user input with a preview, or from a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from webapp.core.geo.fit import (
    ControlPoint,
    Corners,
    GeoreferenceFit,
    Model,
    from_control_points,
    from_corners,
)
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.errors import GeoreferenceError, UsageError
from webapp.files.maps.map_json import georeference_fields
from webapp.files.satellite.georeference_files import (
    find_worldfile,
    parse_worldfile,
    read_control_points,
    read_corners,
    read_geotiff,
    read_worldfile,
)

Kind = Literal["corners", "control-points", "worldfile"]


@dataclass(frozen=True, slots=True)
class GeoreferenceRequest:
    """User input for the georeference of an image."""

    kind: Kind  # "corners", "control-points" or "worldfile"
    corners: Corners | None = None
    points: Sequence[ControlPoint] = ()
    model: Model | None = None  # "similarity", "affine" or "projective". For control points.
    worldfile: str | None = None  # Content of the file
    crs: str | None = None  # Coordinate system of the world file


def fit(request: GeoreferenceRequest, *, width: int, height: int) -> GeoreferenceFit:
    """Fit a georeference to user input.

    Raises:
        UsageError: The input that its kind requires is missing.
        GeoreferenceError: The input gives no georeference.
    """
    if request.kind == "corners":
        if request.corners is None:
            raise UsageError(
                "the corners are missing", where="corners", hint="give top_left and bottom_right"
            )
        return from_corners(request.corners, width=width, height=height)
    if request.kind == "worldfile":
        if request.worldfile is None:
            raise UsageError("the world file is missing", where="worldfile", hint="send its six lines")
        return parse_worldfile(
            request.worldfile, where="world file", width=width, height=height, crs=request.crs or None
        )
    return from_control_points(request.points, width=width, height=height, model=request.model)


def preview(
    found: GeoreferenceFit, request: GeoreferenceRequest, *, width: int, height: int
) -> dict[str, Any]:
    """Describe a georeference, for a check before it is applied.

    Returns:
        `kind` (the fit), `residuals` (metres, one per control point), `rms_m`, `warnings`, `corners`
            (`top_left` and so on, each `lat`, `lon`), `metres_per_pixel`, `north_deg`, `points` (for each
            control point `x`, `y`, `lat`, `lon` as given, the pixel `fitted_x`, `fitted_y` of its latitude
            and longitude, `fitted_lat`, `fitted_lon` of its pixel, `residual_m`) and `georeference` as in
            `map.json`.
    """
    georeference = found.georeference
    residuals = list(found.residuals_m)
    return {
        "kind": georeference.method,
        "residuals": residuals,
        "rms_m": math.sqrt(sum(r * r for r in residuals) / len(residuals)) if residuals else None,
        "warnings": list(found.warnings),
        "points": _points(georeference, request.points, residuals)
        if request.kind == "control-points"
        else [],
        "georeference": georeference_fields(georeference),
        **on_earth(georeference, width=width, height=height),
    }


def on_earth(georeference: Georeference, *, width: int, height: int) -> dict[str, Any]:
    """Return the image's `corners`, and `metres_per_pixel` and `north_deg` in its middle; None if unknown."""
    names = ("top_left", "top_right", "bottom_right", "bottom_left")
    around = georeference.latlon_from_pixel([(0, 0), (width, 0), (width, height), (0, height)])
    middle = MapPixel(width / 2, height / 2)
    corners = {
        name: {"lat": lat, "lon": lon} if np.isfinite([lat, lon]).all() else None
        for name, (lat, lon) in zip(names, around.tolist(), strict=True)
    }
    return {
        "corners": corners,
        "metres_per_pixel": _finite(georeference.metres_per_pixel(middle)),
        "north_deg": _finite(georeference.north_deg(middle)),
    }


def _points(
    georeference: Georeference, points: Sequence[ControlPoint], residuals: Sequence[float]
) -> list[dict[str, Any]]:
    pixels = georeference.pixel_from_latlon([p.position for p in points]).tolist()
    places = georeference.latlon_from_pixel([p.pixel for p in points]).tolist()
    return [
        {
            "x": point.pixel.x,
            "y": point.pixel.y,
            "lat": point.position.lat,
            "lon": point.position.lon,
            "fitted_x": _finite(x),
            "fitted_y": _finite(y),
            "fitted_lat": _finite(lat),
            "fitted_lon": _finite(lon),
            "residual_m": residual,
        }
        for point, (x, y), (lat, lon), residual in zip(points, pixels, places, residuals, strict=True)
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class GeoSource:
    kind: Literal["corners", "geotiff", "worldfile", "control-points"]  #
    # Required for corners and control points; by default, a world file is looked for next to the image. A
    # GeoTIFF is the image itself.
    file: Path | None = None
    crs: str | None = None  # Coordinate system of a world file or GeoTIFF that does not state it
    # "similarity", "affine" or "projective". For control points; None takes the most general that their
    # number allows.
    model: Model | None = None


def georeference_image(image: Path, source: GeoSource, *, width: int, height: int) -> GeoreferenceFit:
    """Make the georeference of an image.

    Raises:
        GeoreferenceError, TableError: The source gives none; `where` names its file.
        UsageError: A coordinate system or model does not apply to this kind of source, or the file is
            missing.
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
