"""The exported page of a mission is self-contained, and texts are escaped."""

import json
import re

import pytest

from webapp.errors import UsageError
from webapp.missions.render import export_file
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionObject
from webapp.settings import Settings
from webapp.tasks.maps import adopt_map

TITLE = "</title><script>window.hacked = 1</script>"
GEO = {
    "format": "experience-map",
    "version": 1,
    "georeference": {
        "plane": "EPSG:4326",
        "plane_from_pixel": [[1e-5, 0, 14.0], [0, -1e-5, 50.0], [0, 0, 1]],
        "method": "corners",
    },
}


def page(library, mission):
    download = export_file.export_mission_file(library, mission, form="html", settings=Settings())
    return b"".join(download.pieces).decode()


def test_it_needs_no_network_and_no_text_becomes_html(library, new_mission):
    mission = new_mission(10, name="Yard")
    with library.database.write() as session:
        session.get_one(Mission, mission).name = TITLE
        session.query(MissionObject).filter_by(object_id="o1").one().kind = "<img src=x onerror=hacked()>"
    text = page(library, mission)
    for attribute in ('src="http', "src='http", 'href="http', "url(http", "@import", TITLE, "<img src=x"):
        assert attribute not in text
    assert text.count("data:image/png") >= 2
    assert "L.imageOverlay(" not in text.rsplit("</style>", 1)[-1]


def test_a_long_track_is_thinned(library, new_mission, monkeypatch):
    monkeypatch.setattr(export_file, "MAX_POSES", 50)
    text = page(library, new_mission(5000))
    points = json.loads(re.search(r'"coordinates": (\[\[.*?\]\])', text)[1])
    assert len(points) == 50


def test_it_lies_on_the_image_of_its_map(library, new_mission, owner, make_map):
    cfg = make_map(library.map_folder("park"), 1)
    cfg.with_name("map.json").write_text(json.dumps(GEO))
    map_id = adopt_map.adopt_map(library, "park", account_id=owner)
    mission = new_mission(10)
    with library.database.write() as session:
        session.get_one(Mission, mission).map_id = map_id
    assert "data:image/webp" in page(library, mission)


def test_too_many_objects_and_none_at_all(library, owner, new_mission, monkeypatch):
    with library.database.write() as session:
        empty = missions.create(session, "Empty", account_id=owner).id
    assert "L.Control.Scale" in page(library, empty)
    monkeypatch.setattr(export_file, "MAX_OBJECTS", 2)
    with pytest.raises(UsageError, match="2 objects"):
        page(library, new_mission(objects=3))


def test_there_is_no_other_format(library, new_mission):
    with pytest.raises(UsageError, match="unknown export format"):
        export_file.export_mission_file(library, new_mission(), form="docx", settings=Settings())
