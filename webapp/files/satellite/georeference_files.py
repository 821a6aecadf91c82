"""Reads files with the georeference of an image.

- corners: JSON with the positions of the image's corners
- control points: a table `x;y;lat;lon` of known points
- world file: six numbers in a file next to the image, optionally a `.prj` with the coordinate system
- GeoTIFF: the image's own transform or ground control points
"""

from __future__ import annotations

import io
import math
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from webapp.core.geo.crs import WGS84, crs_name, latlon_from_plane
from webapp.core.geo.fit import (
    ControlPoint,
    Corners,
    GeoreferenceFit,
    check_on_image,
    check_positions,
    from_control_points,
)
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError, MapJsonError, TableError, TrackError
from webapp.extras import extra
from webapp.files.exchange.xml import local_name, walk
from webapp.files.json_fields import JsonField, finite, parse_json
from webapp.files.text_file import TextRow, read_bytes, read_table, read_text

if TYPE_CHECKING:
    from rasterio.crs import CRS
    from rasterio.io import DatasetReader

_EXAMPLE = '{"top_left": {"lat": 60.4055, "lon": 22.4676}, "bottom_right": {"lat": 60.4039, "lon": 22.4712}}'

CORNER_SUFFIX = ".json"
HEADER = "x;y;lat;lon"
_QGIS_CRS = re.compile(r"#\s*CRS:\s*(.+)", re.IGNORECASE)
_QGIS_PIXELS = (("sourcex", "sourcey"), ("pixelx", "pixely"))
"""Columns of pixels, since QGIS 3.26 and before; y counts upwards, and is negative below the top edge."""

_HINT = "a world file has six lines: x size, rotation, rotation, -y size, x and y of the first pixel's centre"
_CENTRE_FROM_CORNER = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
"""The origin of world files is the centre of the first pixel, that of maps its outer corner."""

_MOST_AUX_BYTES = 5_000_000
"""Statistics of large images take most of them."""

_ALONE = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO", "PROJ_NETWORK": "OFF"}
"""GDAL options to read only the file itself: no sidecar files, nothing from the network."""


def read_corners(path: Path) -> Corners:
    """Read a corners file.

    Besides the corners it may only hold a `note`.
    """
    return parse_corners(read_bytes(path, error=GeoreferenceError), where=str(path))


def parse_corners(data: bytes, *, where: str = "corners") -> Corners:
    """Parse the content of a corners file; see `read_corners`."""
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
    # the range is checked later, with the rest of the geometry, which can reveal swapped values
    return LatLon(
        *(fields[name].number("a finite number of degrees", valid=finite) for name in ("lat", "lon"))
    )


def read_control_points(path: Path) -> list[ControlPoint]:
    """Read control points.

    Args:
        path: Semicolon table with the header `x;y;lat;lon`: pixels right of and below the image's outer
            top-left corner, degrees north and east; or points of QGIS (`.points`).
    """
    qgis = _qgis_points(read_text(path, error=TableError).splitlines(), where=str(path))
    if qgis is not None:
        return qgis
    _, rows = read_table(path, headers=[HEADER])
    if not rows:
        raise TableError("there are no control points", where=str(path), hint=f"add one per line: {HEADER}")
    return [_point(row) for row in rows]


def _qgis_points(lines: list[str], *, where: str) -> list[ControlPoint] | None:
    """Read points of QGIS: a comment with the coordinate system (since QGIS 3.26), and a table with commas.

    Returns:
        None if it is another table.
    """
    stated = _QGIS_CRS.fullmatch(lines[0].strip()) if lines else None
    first = 1 if stated else 0
    header = [cell.strip().lower() for cell in lines[first].split(",")] if len(lines) > first else []
    pixel = next((pair for pair in _QGIS_PIXELS if set(pair) <= set(header)), None)
    if pixel is None or not {"mapx", "mapy"} <= set(header):
        return None
    rows = []
    for number, line in enumerate(lines[first + 1 :], first + 2):
        cells = tuple(line.split(","))
        if line.strip() and len(cells) < len(header):
            raise TableError("the line has too few columns", where=f"{where}:{number}")
        row = TextRow(cells, f"{where}:{number}")
        if line.strip() and ("enable" not in header or row.number(header.index("enable")) != 0.0):
            rows.append(row)
    if not rows:
        raise TableError("there are no control points", where=where, hint="enable some in QGIS")
    numbers = [[row.number(header.index(name)) for name in ("mapx", "mapy", *pixel)] for row in rows]
    plane = crs_name(stated[1]) if stated else WGS84
    if plane == WGS84 and any(abs(x) > 180.0 or abs(y) > 90.0 for x, y, *_ in numbers):
        hint = "begin the file with a line such as #CRS: EPSG:32633, or save it with a newer QGIS"
        raise TableError("the points state no coordinate system", where=where, hint=hint)
    found = latlon_from_plane(plane, [row[:2] for row in numbers]).tolist()
    return [
        _checked_point(MapPixel(x, -y), LatLon(*at), row.where)
        for row, (_, _, x, y), at in zip(rows, numbers, found, strict=True)
    ]


def _point(row: TextRow) -> ControlPoint:
    x, y, lat, lon = (row.number(column) for column in range(4))
    return _checked_point(MapPixel(x, y), LatLon(lat, lon), row.where)


def _checked_point(pixel: MapPixel, position: LatLon, where: str) -> ControlPoint:
    try:
        check_positions([position])
    except GeoreferenceError as error:
        raise TableError(error.message, where=where, hint=error.hint) from error
    return ControlPoint(pixel, position)


def worldfile_suffixes(suffix: str) -> list[str]:
    """List the suffixes of world files for images with a suffix, the usual one first."""
    ending = suffix[1:].lower()
    return [f".{ending[:1]}{ending[-1:]}w", f".{ending}w", ".wld"]


def find_worldfile(image: Path) -> Path:
    """Find the world file of an image: `.pgw`, `.pngw` or `.wld` for a `.png`, and so on, ignoring case.

    Raises:
        GeoreferenceError: There is none.
    """
    names = [f"{image.stem}{suffix}" for suffix in worldfile_suffixes(image.suffix)]
    names += [f"{image.name}w", f"{image.name}.wld"]
    siblings = {p.name.lower(): p for p in sorted(image.parent.iterdir())} if image.parent.is_dir() else {}
    for name in names:
        if name.lower() in siblings:
            return siblings[name.lower()]
    raise GeoreferenceError(
        "the image has no world file next to it",
        where=str(image),
        hint=f"add {names[0]}, or name the world file",
    )


def read_worldfile(path: Path, *, width: int, height: int, crs: str | None = None) -> GeoreferenceFit:
    """Read a world file.

    Args:
        crs: Coordinate system of the numbers. Default: the one of the `.prj` next to it, else EPSG:4326
            (degrees of longitude and latitude), if the numbers are in its range.

    Raises:
        GeoreferenceError: The file cannot be read, does not hold six numbers, has no plausible coordinate
            system, or mirrors the Earth.
    """
    text = read_text(path, error=GeoreferenceError)
    return parse_worldfile(text, where=str(path), width=width, height=height, crs=crs or _sibling_prj(path))


def parse_worldfile(
    text: str, *, where: str, width: int, height: int, crs: str | None = None
) -> GeoreferenceFit:
    """Parse the content of a world file; see `read_worldfile`.

    Args:
        crs: Default: EPSG:4326, if the numbers are in its range.
    """
    a, d, b, e, c, f = _six_numbers(text, where)
    centres = np.array([[a, b, c], [d, e, f], [0.0, 0.0, 1.0]])
    matrix = centres @ _CENTRE_FROM_CORNER
    plane = crs_name(crs) if crs else None
    if plane is None:
        _check_degrees(matrix, where, width=width, height=height)
        plane = WGS84
    try:
        georeference = Georeference(plane, tuple(float(v) for v in matrix.ravel()), "worldfile")
        check_on_image(georeference, width=width, height=height)
    except GeoreferenceError as error:
        raise GeoreferenceError(error.message, where=where, hint=error.hint or _HINT) from error
    return GeoreferenceFit(georeference)


def _six_numbers(text: str, where: str) -> list[float]:
    lines = text.split()
    try:
        # some programs write decimal commas, depending on the locale
        numbers = [float(line.replace(",", ".")) for line in lines]
    except ValueError as error:
        raise GeoreferenceError("a line is not a number", where=where, hint=_HINT) from error
    if len(numbers) != 6 or not all(math.isfinite(n) for n in numbers):
        raise GeoreferenceError(f"it holds {len(numbers)} numbers, not 6", where=where, hint=_HINT)
    return numbers


def _sibling_prj(path: Path) -> str | None:
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


def read_geotiff(path: Path, *, crs: str | None = None) -> GeoreferenceFit:
    """Read the georeference of a GeoTIFF.

    Returns:
        The exact transform (without residuals), or if there is none, a least-squares fit to the ground
            control points.

    Raises:
        GeoreferenceError: It is not a TIFF, has no georeference or coordinate system, or does not show the
            Earth from above.
        MissingPart: rasterio is not installed.
    """
    with extra("geotiff"):
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    if not path.is_file():
        raise GeoreferenceError("file not found", where=str(path), hint="check its path")
    try:
        with rasterio.Env(**_ALONE), warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path, driver="GTiff") as dataset:
                return _fit(dataset, crs or (None if _states_crs(dataset) else _sibling_aux(path)))
    except RasterioError as error:
        hint = "use --corners, --worldfile or --control-points for other images"
        raise GeoreferenceError("it is not a readable GeoTIFF", where=str(path), hint=hint) from error
    except GeoreferenceError as error:
        raise GeoreferenceError(error.message, where=str(path), hint=error.hint) from error


def _states_crs(dataset: DatasetReader) -> bool:
    return bool(dataset.crs) or bool(dataset.gcps[1])


def _sibling_aux(path: Path) -> str | None:
    """Return the coordinate system in the `.aux.xml` next to an image, of GDAL or ArcGIS; None without it.

    GDAL itself must not read it: a sidecar could name other files.
    """
    aux = path.with_name(f"{path.name}.aux.xml")
    if not aux.is_file():
        return None
    data = read_bytes(aux, error=GeoreferenceError)
    try:
        if len(data) > _MOST_AUX_BYTES:
            raise TrackError("the file is too large")
        for _, element in walk(io.BytesIO(data), whole={"SRS"}):
            if local_name(element) == "SRS" and (element.text or "").strip():
                return crs_name((element.text or "").strip())
    except (TrackError, GeoreferenceError) as error:
        raise GeoreferenceError(error.message, where=str(aux), hint=error.hint) from error
    return None


def _fit(dataset: DatasetReader, crs: str | None) -> GeoreferenceFit:
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
    return GeoreferenceFit(georeference)


def _plane(stated: CRS | None, chosen: str | None) -> str:
    if chosen:
        return crs_name(chosen)
    if not stated:
        hint = "give it, such as --crs EPSG:32633"
        raise GeoreferenceError("the TIFF states no coordinate system", hint=hint)
    return crs_name(stated.to_wkt())
