"""Notes on floors through the API: created, moved, aligned, kept if a floor is removed, exported, printed."""

import json

import pytest

from tests.web.maps.images import CORNERS, png
from webapp.errors import MapJsonError
from webapp.files.maps.map_json import parse_map_json
from webapp.tasks.exchange.import_map import import_map
from webapp.tasks.maps.export import export_late_maps


@pytest.fixture
def url(client, park):
    """The address of a georeferenced map with two floors."""
    url = f"/api/v1/maps/{park}"
    satellite = {"file": (png(), "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"{url}/satellite", data=satellite).status_code == 200
    plan = {"name": "1st floor", "level": 1, "file": (png((150, 100)), "plan.png")}
    assert client.post(f"{url}/floors", data=plan).status_code == 201
    return url


@pytest.fixture
def other(client, url, new_account, sign_in):
    """The browser of another editor of the map."""
    ben = new_account("Ben")
    assert client.post(f"{url}/members", json={"name": "Ben", "role": "editor"}).status_code in (200, 201)
    return sign_in(ben)


def write(client, url, **fields):
    return client.post(f"{url}/notes", json={"title": "Lift", "x_px": 20, "y_px": 30, **fields})


def note(client, url):
    (found,) = client.get(f"{url}/notes").json["notes"]
    return found


def files(library, park):
    export_late_maps(library)
    path = library.cfg(park).with_name("map.json")
    return path, json.loads(path.read_bytes())


def test_a_note_is_on_the_floor_that_it_was_written_on_and_is_moved_to_another(client, url, library, park):
    answer = write(client, url, floor=1)
    assert (answer.status_code, answer.json["notes"][0]["floor"]) == (201, 1)
    assert files(library, park)[1]["notes"][0]["floor"] == 1
    down = {"title": "Lift", "x_px": 20, "y_px": 30, "floor": 0}
    assert client.put(f"{url}/notes/1", json=down).status_code == 200
    assert note(client, url)["floor"] == 0
    assert "floor" not in files(library, park)[1]["notes"][0]
    client.post(f"{url}/undo")
    assert note(client, url)["floor"] == 1


def test_a_program_that_does_not_know_of_floors_leaves_a_note_on_its_floor(client, url):
    assert write(client, url).json["notes"][0]["floor"] == 0
    client.put(f"{url}/notes/1", json={"title": "Lift", "x_px": 20, "y_px": 30, "floor": 1})
    client.put(f"{url}/notes/1", json={"title": "Lift B", "x_px": 25, "y_px": 30})
    assert (note(client, url)["title"], note(client, url)["floor"]) == ("Lift B", 1)


def test_a_floor_that_is_not_there_is_refused(client, url):
    refused = write(client, url, floor=7)
    assert (refused.status_code, refused.json["error"]["where"]) == (400, "floor")
    assert client.get(f"{url}/notes").json["notes"] == []


def test_the_notes_of_a_floor_that_is_removed_come_to_that_of_the_maps_image(client, url):
    write(client, url, floor=1)
    assert client.delete(f"{url}/floors/1").status_code == 200
    assert (note(client, url)["x_px"], note(client, url)["floor"]) == (20, 0)
    assert client.post(f"{url}/undo").status_code == 200
    assert note(client, url)["floor"] == 1
    client.post(f"{url}/redo")
    assert note(client, url)["floor"] == 0


def test_the_undo_of_a_floor_is_refused_where_somebody_has_written_a_note_on_it(client, url, other):
    write(other, url, floor=1)
    refused = client.post(f"{url}/undo")
    assert refused.status_code == 409
    assert "notes were written on the floor in the meantime" in refused.json["error"]["message"]
    assert note(client, url)["floor"] == 1


def test_a_note_does_not_come_back_to_a_floor_that_somebody_has_removed(client, url, other):
    write(client, url, floor=1)
    client.delete(f"{url}/notes/1")
    assert other.delete(f"{url}/floors/1").status_code == 200
    refused = client.post(f"{url}/undo")
    assert refused.status_code == 409
    assert "the floor has been removed in the meantime" in refused.json["error"]["message"]
    assert client.get(f"{url}/notes").json["notes"] == []


def test_notes_are_aligned_with_their_floor(client, url):
    write(client, url, floor=1)
    shifted = {"pairs": [{"shown": [0, 0], "wanted": [40, 10]}]}
    assert client.post(f"{url}/floors/1/align", json=shifted).status_code == 200
    assert (note(client, url)["x_px"], note(client, url)["y_px"]) == (60, 40)
    client.post(f"{url}/undo")
    assert note(client, url)["x_px"] == 20
    away = {"pairs": [{"shown": [0, 0], "wanted": [290, 0]}]}
    assert (
        "Lift would be moved off the map"
        in client.post(f"{url}/floors/1/align", json=away).json["error"]["message"]
    )
    assert note(client, url)["x_px"] == 20


def test_a_zip_and_geojson_have_the_floor_of_a_note(client, url, library, owner, settings, tmp_path):
    write(client, url, floor=1)
    archive = tmp_path / "park.zip"
    archive.write_bytes(client.get(f"{url}/export.zip").data)
    made = import_map(library, archive, account_id=owner.id, name="Copy", settings=settings)
    assert note(client, f"/api/v1/maps/{made.slug}")["floor"] == 1
    (feature,) = json.loads(client.get(f"{url}/export.geojson").data)["features"]
    assert (feature["properties"]["floor"], feature["properties"]["level"]) == ("1st floor", 1)


def test_files_that_know_of_no_floors_leave_notes_on_theirs(client, url, library, park):
    write(client, url, floor=1)
    path, known = files(library, park)
    del known["floors"], known["notes"][0]["floor"]
    known["notes"][0]["title"] = "Lift B"
    path.write_text(json.dumps(known))
    cfg = library.cfg(park)
    cfg.write_text(cfg.read_text() + "\n")
    shown = client.get(f"{url}/outside-edit").json
    assert shown["notes"] == ["Lift B"]
    assert client.post(f"{url}/outside-edit/take", json={"sha256": shown["sha256"]}).status_code == 200
    assert (note(client, url)["title"], note(client, url)["floor"]) == ("Lift B", 1)


def test_a_note_on_a_floor_that_is_not_there_is_refused_in_map_json():
    content = {"format": "experience-map", "version": 1, "notes": [{"id": 4, "title": "Lift", "floor": 3}]}
    with pytest.raises(MapJsonError, match="note 4 on the floor 3"):
        parse_map_json(json.dumps(content).encode())


def test_all_floors_are_printed_as_the_pages_of_one_pdf(client, url):
    answer = client.get(f"{url}/print.pdf?all_floors=true&dpi=40")
    assert (answer.status_code, answer.data.count(b"/Type /Page\n")) == (200, 2)
    refused = client.get(f"{url}/print.png?all_floors=true")
    assert refused.status_code == 400
    assert "only a PDF" in refused.json["error"]["message"]
