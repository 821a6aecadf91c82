"""Downloads of a map and of a mission as GeoPackage, and their entries in the export menus."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from apiflask import APIBlueprint
from flask import Response

from webapp.connect.gis.geopackage import new_package
from webapp.connect.gis.layers import add_map, add_mission
from webapp.errors import UsageError
from webapp.missions.store import reading
from webapp.missions.web.api_exports import ExportQuery, stream_download
from webapp.missions.web.context import mission_role, open_mission
from webapp.progress import Progress
from webapp.tasks.exchange.export_source import Download, of_library, plain_name
from webapp.web.context import library, map_role, open_map
from webapp.web.openapi import file_answer
from webapp.web.sending import send_pieces
from webapp.web.state import ExportLink

blueprint = APIBlueprint("api_geopackage", __name__, url_prefix="/api/v1", tag="Import and export")

MENU = {kind: (ExportLink("export.gpkg", "GeoPackage (QGIS, QField)"),) for kind in ("map", "mission")}
OPERATIONS = {"api_geopackage.export_map": {"statuses": [400]}}

_MEDIA_TYPE = "application/geopackage+sqlite3"
_MOST_POSES = 1_000_000
"""Poses in a download, which begins only when all are written: some 20 s."""

_CHUNK = 1 << 18


@blueprint.get("/maps/<slug>/export.gpkg")
@map_role("viewer")
@blueprint.doc(responses=file_answer("The file.", _MEDIA_TYPE))
def export_map(slug: str) -> Response:
    """Download the photos, notes and floors of a map as layers of a GeoPackage.

    Photos are paths from the folder of the map, as in its zip.
    """
    source = of_library(library(), open_map(slug).id)
    source.georeference()
    path = _new_path()
    with new_package(path) as package:
        add_map(package, source, folder=source.cfg.parent, picture=lambda _photo: None, progress=Progress())
    return send_pieces(Download(f"{source.name}.gpkg", _MEDIA_TYPE, _pieces(path)))


@blueprint.get("/missions/<id:mission_id>/export.gpkg")
@mission_role("viewer")
@blueprint.input(ExportQuery, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("The file.", _MEDIA_TYPE))
def export_mission(mission_id: int, query: dict[str, Any]) -> Response:
    """Download the tracks, poses and objects of a mission as layers of a GeoPackage."""
    id = open_mission(mission_id).id
    return stream_download(lambda: _mission(id, most=query["points"]))


def _mission(id: int, *, most: int | None) -> Download:
    found = reading.read(library().database, id, most=most)
    count = sum(track.count for track in found.tracks)
    if count > _MOST_POSES:
        raise UsageError(
            f"the mission has {count} poses, and a download can hold {_MOST_POSES}",
            where="points",
            hint="add ?points=10000 to the address, or use expmap connect gis export-mission",
        )
    path = _new_path()
    with new_package(path) as package:
        add_mission(package, found, progress=Progress())
    return Download(f"{plain_name(found.name)}.gpkg", _MEDIA_TYPE, _pieces(path))


def _new_path() -> Path:
    return library().uploads / f"{secrets.token_hex(16)}.gpkg"


def _pieces(path: Path) -> Iterator[bytes]:
    """Yield the content of a file, whose name is deleted at once: the space is free when it is closed."""
    file = path.open("rb")
    path.unlink()

    def read() -> Iterator[bytes]:
        with file:
            while piece := file.read(_CHUNK):
                yield piece

    return read()
