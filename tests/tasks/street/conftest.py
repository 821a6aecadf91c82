"""A georeferenced map, in a folder or in a library, and a service with photos of its area."""

from dataclasses import replace

import pytest

from tests.street_server import TOKEN, Shot, street
from webapp.core.geo.georeference import Georeference
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings, StreetSettings
from webapp.store.library import open_library
from webapp.store.schema import Account, MapRecord
from webapp.tasks.maps import adopt_map
from webapp.tasks.street.add_street import add_street_photos
from webapp.tasks.street.survey import FolderTarget, LibraryTarget, StreetRequest, survey_street

PLACE = Georeference("EPSG:4326", (1e-5, 0, 14.4, 0, -1e-5, 50.1, 0, 0, 1), "corners")
"""Georeference of an image of 300 x 200 pixels of 0.00001 degrees."""


def at(x, y, id, **fields):
    """Return a photo of the service at a pixel of the map."""
    position = PLACE.latlon_from_pixel([(x, y)])[0]
    return Shot(id, *map(float, position), **fields)


@pytest.fixture
def service():
    shots = [at(50, 40, "a1"), at(150, 120, "b2", azimuth=None), at(250, 60, "c3", azimuth=-10.0)]
    with street(*shots) as server:
        yield server


@pytest.fixture
def settings(service):
    chosen = StreetSettings(
        panoramax=service.base,
        mapillary_token=TOKEN,
        mapillary=service.base,
        requests_per_second=1000.0,
        timeout_s=20.0,
    )
    return Settings(street=chosen)


@pytest.fixture
def cfg(tmp_path, make_map):
    """A map of two photos in a folder."""
    cfg = make_map(tmp_path / "folder", 2)
    write_map(cfg, replace(read_map(cfg), georeference=PLACE))
    return cfg


@pytest.fixture
def library(tmp_path):
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


@pytest.fixture
def map_id(library, make_map):
    """The same map in a library."""
    cfg = make_map(library.map_folder("park"), 2)
    write_map(cfg, replace(read_map(cfg), georeference=PLACE))
    with library.database.write() as session:
        owner = Account(name="ana", is_owner=True)
        session.add(owner)
        session.flush()
        id = owner.id
    return adopt_map.adopt_map(library, "park", account_id=id)


@pytest.fixture
def bring(cfg, settings):
    """Survey an area and add its photos to the map in the folder; return both results."""

    def run(source="panoramax", *, target=None, progress=None, **wishes):
        given = wishes.pop("settings", settings)
        target = target or FolderTarget(cfg, settings=given)
        request = StreetRequest(source, **wishes)
        progress = progress or Progress()
        survey = survey_street(target, request, settings=given.street, progress=progress)
        report = add_street_photos(target, survey, request=request, settings=given, progress=progress)
        return survey, report

    return run


@pytest.fixture
def library_target(library, map_id, settings):
    return LibraryTarget(library, map_id, settings=settings)


@pytest.fixture
def photos(library, map_id):
    """Return the records of the map's photos by name."""

    def read():
        with library.database.read() as session:
            rows = session.get_one(MapRecord, map_id).photos
            return {row.name: row for row in rows}

    return read
