"""What tests of several connections need."""

import pytest
from sqlalchemy import select

from webapp.store.schema import MapRecord

LON, LAT, DEG = 14.0, 50.001, 1e-6
"""Of the top left corner of the map, and degrees to a pixel."""


@pytest.fixture
def park(library, owner, new_map):
    """The slug of a georeferenced map of 1000 by 1000 pixels."""
    slug = new_map(owner)
    plane = [[DEG, 0.0, LON], [0.0, -DEG, LAT], [0.0, 0.0, 1.0]]
    with library.database.write() as session:
        record = session.scalars(select(MapRecord)).one()
        record.satellite_path, record.satellite_width, record.satellite_height = "s.png", 1000, 1000
        record.georeference = {"plane": "EPSG:4326", "plane_from_pixel": plane, "method": "corners"}
    return slug
