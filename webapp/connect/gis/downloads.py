"""Downloads of a map and of a mission as GeoPackage and as project of QGIS, and their menu entries."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from apiflask import APIBlueprint
from flask import Response

from webapp.connect.gis.geopackage import new_package
from webapp.connect.gis.layers import add_map, add_mission
from webapp.connect.gis.project import MEDIA_TYPE as PROJECT_TYPE
from webapp.connect.gis.project import write_project
from webapp.connect.gis.project_image import images_of
from webapp.errors import UsageError
from webapp.missions.core.trajectory.outgoing import MissionExport
from webapp.missions.store import reading
from webapp.missions.store.schema import Mission
from webapp.missions.web.api_exports import ExportQuery, stream_download
from webapp.missions.web.context import mission_role, open_mission
from webapp.progress import Progress
from webapp.store.schema import MapRecord
from webapp.tasks.exchange.export_source import Download, Source, of_library, plain_name
from webapp.web.context import library, map_role, open_map
from webapp.web.openapi import file_answer
from webapp.web.sending import send_pieces
from webapp.web.state import ExportLink, settings

blueprint = APIBlueprint("api_geopackage", __name__, url_prefix="/api/v1", tag="Import and export")

MENU = {
    kind: (ExportLink("export.qgz", "QGIS (.qgz)"), ExportLink("export.gpkg", "GeoPackage (QGIS, QField)"))
    for kind in ("map", "mission")
}
OPERATIONS = {f"api_geopackage.{name}": {"statuses": [400]} for name in ("export_map", "export_map_project")}

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
    path = _new_path()
    _write_map(path, source)
    return send_pieces(Download(f"{source.name}.gpkg", _MEDIA_TYPE, _pieces(path)))


@blueprint.get("/maps/<slug>/export.qgz")
@map_role("viewer")
@blueprint.doc(responses=file_answer("The file.", PROJECT_TYPE))
def export_map_project(slug: str) -> Response:
    """Download a map as a project of QGIS: its images, photos, notes and floors."""
    source = of_library(library(), open_map(slug).id)
    path = _new_path(".qgz")
    with _workplace() as folder:
        _write_map(folder / "layers.gpkg", source)
        images = images_of(source, folder, settings=settings())
        write_project(path, folder / "layers.gpkg", images=images, title=source.title)
    return send_pieces(Download(f"{source.name}.qgz", PROJECT_TYPE, _pieces(path)))


def _write_map(path: Path, source: Source) -> None:
    source.georeference()
    with new_package(path) as package:
        add_map(package, source, folder=source.cfg.parent, picture=lambda _photo: None, progress=Progress())


@blueprint.get("/missions/<id:mission_id>/export.gpkg")
@mission_role("viewer")
@blueprint.input(ExportQuery, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("The file.", _MEDIA_TYPE))
def export_mission(mission_id: int, query: dict[str, Any]) -> Response:
    """Download the tracks, poses and objects of a mission as layers of a GeoPackage."""
    id = open_mission(mission_id).id
    return stream_download(lambda: _package_of(_mission(id, most=query["points"])))


@blueprint.get("/missions/<id:mission_id>/export.qgz")
@mission_role("viewer")
@blueprint.input(ExportQuery, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("The file.", PROJECT_TYPE))
def export_mission_project(mission_id: int, query: dict[str, Any]) -> Response:
    """Download a mission as a project of QGIS: its tracks, objects and areas, on the image of its map."""
    mission = open_mission(mission_id)
    below = _map_below(mission)
    return stream_download(lambda: _project_of(_mission(mission.id, most=query["points"]), below))


def _mission(id: int, *, most: int | None) -> MissionExport:
    found = reading.read(library().database, id, most=most)
    count = sum(track.count for track in found.tracks)
    if count > _MOST_POSES:
        raise UsageError(
            f"the mission has {count} poses, and a download can hold {_MOST_POSES}",
            where="points",
            hint="add ?points=10000 to the address, or use expmap connect gis export-mission",
        )
    return found


def _package_of(found: MissionExport) -> Download:
    path = _new_path()
    with new_package(path) as package:
        add_mission(package, found, progress=Progress())
    return Download(f"{plain_name(found.name)}.gpkg", _MEDIA_TYPE, _pieces(path))


def _project_of(found: MissionExport, source: Source | None) -> Download:
    path = _new_path(".qgz")
    with _workplace() as folder:
        with new_package(folder / "layers.gpkg") as package:
            add_mission(package, found, progress=Progress())
        images = [] if source is None else images_of(source, folder, settings=settings())
        write_project(path, folder / "layers.gpkg", images=images, title=found.name)
    return Download(f"{plain_name(found.name)}.qgz", PROJECT_TYPE, _pieces(path))


def _map_below(mission: Mission) -> Source | None:
    """Return the map of a mission, whose members see it, too; None if nobody knows where its image is."""
    with library().database.read() as session:
        record = None if mission.map_id is None else session.get(MapRecord, mission.map_id)
    if record is None or record.georeference is None or record.satellite_width is None:
        return None
    return of_library(library(), record.id)


@contextmanager
def _workplace() -> Iterator[Path]:
    with TemporaryDirectory(dir=library().uploads) as folder:
        yield Path(folder)


def _new_path(suffix: str = ".gpkg") -> Path:
    return library().uploads / f"{secrets.token_hex(16)}{suffix}"


def _pieces(path: Path) -> Iterator[bytes]:
    """Yield the content of a file, whose name is deleted at once: the space is free when it is closed."""
    file = path.open("rb")
    path.unlink()

    def read() -> Iterator[bytes]:
        with file:
            while piece := file.read(_CHUNK):
                yield piece

    return read()
