"""The georeference inside a GeoTIFF: its transform or its ground control points."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from webapp.core.geo.controlpoints import ControlPoint, from_control_points
from webapp.core.geo.crs import crs_name, latlon_from_plane
from webapp.core.geo.fit import Fit, check_on_image
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError
from webapp.extras import extra

if TYPE_CHECKING:
    from rasterio.crs import CRS
    from rasterio.io import DatasetReader

_ALONE = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO", "PROJ_NETWORK": "OFF"}
"""Only the file itself is read: nothing beside it, nothing from the network."""


def read_geotiff(path: Path, *, crs: str | None = None) -> Fit:
    """Read the georeference of a GeoTIFF.

    Parameters
    ----------
    crs : str, optional
        Instead of the coordinate system that the file states.

    Returns
    -------
    Fit
        Of the transform, exactly (no residuals); where there is none, of the ground control points, by least
        squares.

    Raises
    ------
    GeoreferenceError
        No TIFF, no georeference in it, no coordinate system, or one that describes no image seen from above.
    MissingPart
        rasterio is not installed.
    """
    with extra("geotiff"):
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    if not path.is_file():
        raise GeoreferenceError("there is no such file", where=str(path), hint="check its path")
    try:
        with rasterio.Env(**_ALONE), warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path, driver="GTiff") as dataset:
                return _fit(dataset, crs)
    except RasterioError as error:
        hint = "use --corners, --worldfile or --control-points for other images"
        raise GeoreferenceError("it is not a readable GeoTIFF", where=str(path), hint=hint) from error
    except GeoreferenceError as error:
        raise GeoreferenceError(error.message, where=str(path), hint=error.hint) from error


def _fit(dataset: DatasetReader, crs: str | None) -> Fit:
    points, points_crs = dataset.gcps
    if dataset.transform.is_identity and points:
        plane = _plane(points_crs, crs)
        latlon = latlon_from_plane(plane, [(p.x, p.y) for p in points])
        known = [
            ControlPoint(MapPixel(p.col, p.row), LatLon(*position))
            for p, position in zip(points, latlon.tolist(), strict=True)
        ]
        return from_control_points(known, width=dataset.width, height=dataset.height)
    if dataset.transform.is_identity:
        hint = "use --corners, --worldfile or --control-points"
        raise GeoreferenceError("the TIFF has no georeference", hint=hint)
    matrix = tuple(float(v) for v in dataset.transform)
    georeference = Georeference(_plane(dataset.crs, crs), matrix, "geotiff")
    check_on_image(georeference, width=dataset.width, height=dataset.height)
    return Fit(georeference)


def _plane(stated: CRS | None, chosen: str | None) -> str:
    if chosen:
        return crs_name(chosen)
    if not stated:
        hint = "give it, such as --crs EPSG:32633"
        raise GeoreferenceError("the TIFF states no coordinate system", hint=hint)
    return crs_name(stated.to_wkt())
