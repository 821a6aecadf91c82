"""Projects of QGIS (`.qgz`): the image and the layers of a map or a mission, opened with one click.

A project is a zip of an XML document, `.qgs`, and of the files that it shows, which QGIS, from version 3.22,
unpacks together: `attachment:` in a source stands for the folder of the unpacked files. What QGIS has of a
layer, its style too, is in the GeoPackage, from which the document is made.
"""

from __future__ import annotations

import math
import secrets
import sqlite3
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from webapp.connect.gis.project_image import ProjectImage
from webapp.core.geo.crs import parse_crs
from webapp.errors import UsageError
from webapp.files.atomic import storage_error

MEDIA_TYPE = "application/x-qgis-project"
_VERSION = "3.22.0"
_PACKAGE = "layers.gpkg"
_WGS84 = "EPSG:4326"
_KINDS = {"POINT": "Point", "POLYGON": "Polygon", "MULTILINESTRING": "Line"}
_TOP_FIRST = ("notes", "objects", "photos", "poses", "tracks", "areas", "floors")
_MARGIN = 0.05
"""How much wider than the layers the first view is."""

Box = tuple[float, float, float, float]
"""West, south, east, north."""


class _Layer(NamedTuple):
    id: str
    title: str
    source: str
    element: ET.Element


@dataclass(frozen=True, slots=True)
class _Table:
    """A layer of a GeoPackage."""

    name: str
    title: str
    geometry: str
    box: Box | None  # None if it is empty
    style: str


def write_project(out: Path, package: Path, *, images: Sequence[ProjectImage], title: str) -> None:
    """Write a project that replaces a file once it is complete.

    Args:
        package: The GeoPackage with its layers.
        images: Those below the layers; the first is shown, and is the lowest.

    Raises:
        UsageError: The name has another ending.
        StorageError: It cannot be written.
    """
    if out.suffix.lower() != ".qgz":
        raise UsageError("unknown format", where=out.name, hint="the name of a project of QGIS ends in .qgz")
    part = out.with_name(f".{secrets.token_hex(4)}{out.suffix}")
    tables = _tables(package)
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{out.stem}.qgs", _document(tables, images, title=title))
            archive.write(package, _PACKAGE)
            for image in images:
                archive.writestr(image.description_name, image.description)
                # pictures are compressed already
                archive.write(image.file, image.file.name, zipfile.ZIP_STORED)
        part.replace(out)
    except OSError as error:
        raise storage_error(error, where=str(out)) from error
    finally:
        part.unlink(missing_ok=True)


def _tables(package: Path) -> list[_Table]:
    select = (
        "SELECT table_name, identifier, geometry_type_name, min_x, min_y, max_x, max_y, styleQML"
        " FROM gpkg_contents JOIN gpkg_geometry_columns USING (table_name)"
        " JOIN layer_styles ON f_table_name = table_name"
    )
    with closing(sqlite3.connect(package)) as connection:
        rows = connection.execute(select).fetchall()
    found = [
        _Table(name, title, kind, None if box[0] is None else (box[0], box[1], box[2], box[3]), style)
        for name, title, kind, *box, style in rows
    ]
    return sorted(found, key=lambda table: _TOP_FIRST.index(table.name))


def _document(tables: Iterable[_Table], images: Sequence[ProjectImage], *, title: str) -> bytes:
    tables = list(tables)
    layers = [_vector(table) for table in tables] + [_raster(image) for image in reversed(images)]
    root = ET.Element("qgis", {"projectname": title, "version": _VERSION})
    _text(root, "title", title)
    root.append(_system("projectCrs", _WGS84))
    tree = ET.SubElement(root, "layer-tree-group")
    ET.SubElement(tree, "customproperties")
    hidden = {image.title for image in images[1:]}
    for layer in layers:
        checked = "Qt::Unchecked" if layer.title in hidden else "Qt::Checked"
        provider = "gdal" if layer.element.get("type") == "raster" else "ogr"
        about = {"id": layer.id, "name": layer.title, "source": layer.source, "providerKey": provider}
        ET.SubElement(tree, "layer-tree-layer", {**about, "checked": checked, "expanded": "1"})
    canvas = ET.SubElement(root, "mapcanvas", {"name": "theMapCanvas", "annotationsVisible": "1"})
    _text(canvas, "units", "degrees")
    boxes = [*(image.box for image in images), *(table.box for table in tables)]
    _extent(canvas, _around([box for box in boxes if box is not None]))
    _text(canvas, "rotation", "0")
    canvas.append(_system("destinationsrs", _WGS84))
    found = ET.SubElement(root, "projectlayers")
    found.extend(layer.element for layer in layers)
    order = ET.SubElement(root, "layerorder")
    for layer in layers:
        ET.SubElement(order, "layer", {"id": layer.id})
    paths = ET.SubElement(ET.SubElement(root, "properties"), "Paths")
    _text(paths, "Absolute", "false").set("type", "bool")
    head = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
    return (head + ET.tostring(root, "unicode")).encode("utf-8", "xmlcharrefreplace")


def _vector(table: _Table) -> _Layer:
    style = ET.fromstring(table.style.partition("\n")[2])
    about = {"type": "vector", "geometry": _KINDS[table.geometry], "styleCategories": "AllStyleCategories"}
    element = ET.Element("maplayer", {**about, "labelsEnabled": style.get("labelsEnabled", "0")})
    source = f"attachment:{_PACKAGE}|layername={table.name}"
    _common(element, table.name, source=source, title=table.title, box=table.box)
    element.append(_system("srs", _WGS84))
    _text(element, "provider", "ogr").set("encoding", "UTF-8")
    element.extend(style)
    return _Layer(table.name, table.title, source, element)


def _raster(image: ProjectImage) -> _Layer:
    id = image.file.stem
    element = ET.Element("maplayer", {"type": "raster", "styleCategories": "AllStyleCategories"})
    source = f"attachment:{image.description_name}"
    _common(element, id, source=source, title=image.title, box=image.plane_box)
    element.append(_system("srs", image.plane))
    _text(element, "provider", "gdal")
    return _Layer(id, image.title, source, element)


def _common(element: ET.Element, id: str, *, source: str, title: str, box: Box | None) -> None:
    if box is not None:
        _extent(element, box)
    _text(element, "id", id)
    _text(element, "datasource", source)
    _text(element, "layername", title)


def _system(name: str, plane: str) -> ET.Element:
    """Describe a coordinate system as QGIS does: by its code if it has one, else by its WKT."""
    crs = parse_crs(plane)
    element = ET.Element(name)
    system = ET.SubElement(element, "spatialrefsys", {"nativeFormat": "Wkt"})
    _text(system, "wkt", crs.to_wkt())
    authority = crs.to_authority()
    if authority is not None:
        _text(system, "authid", ":".join(authority))
    _text(system, "description", crs.name)
    _text(system, "geographicflag", str(crs.is_geographic).lower())
    return element


def _around(boxes: Sequence[Box]) -> Box:
    """Return the area of all boxes and a margin; the world if there is none."""
    if not boxes:
        return (-180.0, -90.0, 180.0, 90.0)
    west, south = (min(box[n] for box in boxes) for n in (0, 1))
    east, north = (max(box[n] for box in boxes) for n in (2, 3))
    margin = max(_MARGIN * math.hypot(east - west, north - south), 1e-4)
    return (west - margin, south - margin, east + margin, north + margin)


def _extent(parent: ET.Element, box: Box) -> None:
    extent = ET.SubElement(parent, "extent")
    for name, value in zip(("xmin", "ymin", "xmax", "ymax"), box, strict=True):
        _text(extent, name, repr(float(value)))


def _text(parent: ET.Element, name: str, text: str) -> ET.Element:
    element = ET.SubElement(parent, name)
    element.text = "".join(c for c in text if c in "\t\n\r" or c >= " ")  # XML has no control characters
    return element
