"""Notes on photos and positions through the API: written, undone, shared if allowed, export and import."""

import io
import json
from xml.etree import ElementTree

import pytest

from tests.web.maps.images import CORNERS, png
from webapp.errors import MapJsonError
from webapp.files.maps.map_json import parse_map_json

KML = {"k": "http://www.opengis.net/kml/2.2"}


@pytest.fixture
def url(client, park):
    """The address of a georeferenced map with two photos, one of them placed."""
    url = f"/api/v1/maps/{park}"
    satellite = {"file": (png(), "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"{url}/satellite", data=satellite).status_code == 200
    for n in range(2):
        client.post(f"{url}/photos", data={"file": (png((40 + n, 30)), f"{n}.png")})
    place = {"kind": "place", "changes": [{"id": 0, "x_px": 50, "y_px": 100}]}
    assert client.patch(f"{url}/experiences", json=place).status_code == 200
    return url


def write(client, url, **fields):
    wish = {
        "title": "Bench",
        "text": "Since May.\nTwo seats.",
        "x_px": 20,
        "y_px": 30,
        "photos": [0],
        **fields,
    }
    return client.post(f"{url}/notes", json=wish)


def notes(client, url):
    return client.get(f"{url}/notes").json["notes"]


def note_of(client, url, id):
    return next(photo["note"] for photo in client.get(url).json["photos"] if photo["id"] == id)


def test_a_note_is_added_changed_and_removed_and_each_step_undone(client, url):
    answer = write(client, url)
    assert answer.status_code == 201
    first = {
        "id": 1,
        "title": "Bench",
        "text": "Since May.\nTwo seats.",
        "x_px": 20,
        "y_px": 30,
        "photos": [0],
        "floor": 0,
    }
    assert answer.json["notes"] == [first]
    assert answer.json["undo"] == {"kind": "notes", "count": 1}
    write(client, url, title="Gate", photos=[])
    moved = {**first, "x_px": 40}
    wish = {key: value for key, value in moved.items() if key != "id"}
    assert client.put(f"{url}/notes/1", json=wish).json["notes"][0] == moved
    assert [note["id"] for note in client.delete(f"{url}/notes/1").json["notes"]] == [2]
    assert client.post(f"{url}/undo", json={}).json["notes"][0] == moved
    assert client.post(f"{url}/undo", json={}).json["notes"][0] == first
    assert client.post(f"{url}/redo", json={}).json["notes"][0] == moved
    since = client.get(f"{url}/changes?since=0").json
    assert [note["title"] for note in since["notes"]] == ["Bench", "Gate"]
    assert "notes" not in client.get(f"{url}/changes?since={since['revision']}").json


@pytest.mark.parametrize(
    ("fields", "status"),
    [({"title": " "}, 400), ({"title": "two\nlines"}, 400), ({"x_px": 301}, 400), ({"photos": [7]}, 404),
     ({"text": "a\x00b"}, 400), ({"title": ""}, 422), ({"text": "x" * 4001}, 422)],
)  # fmt: skip
def test_what_cannot_be_noted_is_refused(client, url, fields, status):
    assert write(client, url, **fields).status_code == status
    assert notes(client, url) == []


def test_notes_have_french_spaces_and_joined_emoji(client, url):
    text = "Attention\u00a0: fermé\u202f! \U0001f468\u200d\U0001f469\u200d\U0001f467"
    assert write(client, url, title=text, text=text).status_code == 201
    assert [(note["title"], note["text"]) for note in notes(client, url)] == [(text, text)]


def test_a_note_that_is_gone_cannot_be_changed(client, url):
    wish = {"title": "Bench", "x_px": 20, "y_px": 30}
    assert client.put(f"{url}/notes/3", json=wish).status_code == 404
    assert client.delete(f"{url}/notes/3").status_code == 404


def test_a_note_that_was_changed_since_is_not_overwritten(client, url):
    known = {"If-Match": str(write(client, url).json["revision"])}
    wish = {"title": "Bench", "x_px": 20, "y_px": 30}
    changed = client.put(f"{url}/notes/1", json={**wish, "text": "Green."}, headers=known)
    assert changed.status_code == 200
    late = client.put(f"{url}/notes/1", json={**wish, "text": "Red."}, headers=known)
    assert (late.status_code, client.delete(f"{url}/notes/1", headers=known).status_code) == (412, 412)
    assert "changed the note in the meantime" in late.json["error"]["message"]
    assert [note["text"] for note in notes(client, url)] == ["Green."]
    newest = {"If-Match": str(changed.json["revision"])}
    assert client.delete(f"{url}/notes/1", headers=newest).json["notes"] == []


def test_a_photo_has_a_note_that_can_be_undone(client, url):
    edit = {"kind": "note", "changes": [{"id": 1, "note": " The gate was blue.\n"}]}
    assert client.patch(f"{url}/experiences", json=edit).json["undo"] == {"kind": "note", "count": 1}
    assert note_of(client, url, 1) == "The gate was blue."
    assert client.patch(f"{url}/experiences/1", json={"note": ""}).json["undo"]["kind"] == "note"
    assert note_of(client, url, 1) is None
    client.post(f"{url}/undo", json={})
    assert note_of(client, url, 1) == "The gate was blue."
    assert client.patch(f"{url}/experiences/1", json={"note": "a\x07"}).status_code == 400


def test_notes_go_with_the_image_and_those_outside_keep_what_they_say(client, url):
    write(client, url)
    write(client, url, title="Far", x_px=290, photos=[])
    half = {"top_left": CORNERS["top_left"], "bottom_right": {"lat": 50.098, "lon": 14.4015}}
    satellite = {"file": (png((300, 400)), "t.png"), "corners": json.dumps(half)}
    assert client.put(f"{url}/satellite", data=satellite).status_code == 200
    near, far = notes(client, url)
    assert (near["x_px"], near["y_px"]) == pytest.approx((40, 60), abs=0.1)
    assert (far["title"], far["x_px"], far["y_px"]) == ("Far", None, None)


def test_zips_have_all_notes_and_bring_them_back(client, url):
    write(client, url)
    for id, text in ((0, "on it"), (1, "in the tray")):
        client.patch(f"{url}/experiences/{id}", json={"note": text})
    file = io.BytesIO(client.get(f"{url}/export.zip").data)
    made = client.post("/api/v1/maps/import", data={"file": (file, "map.zip")})
    assert made.status_code == 201
    copy = f"/api/v1/maps/{made.json['slug']}"
    assert notes(client, copy) == notes(client, url)
    assert (note_of(client, copy, 0), note_of(client, copy, 1)) == ("on it", "in the tray")
    again = f"/api/v1/maps/{client.post(f'{url}/duplicate', json={}).json['slug']}"
    assert notes(client, again) == notes(client, url)
    assert note_of(client, again, 0) == "on it"


def test_exports_for_the_earth_have_them(client, url):
    write(client, url, title="<b> & co", text="")
    client.patch(f"{url}/experiences/0", json={"note": "on it"})
    photo, note = json.loads(client.get(f"{url}/export.geojson").data)["features"]
    assert photo["properties"]["note"] == "on it"
    assert (note["id"], note["properties"]["title"]) == ("note-1", "<b> & co")
    assert note["geometry"]["coordinates"] == pytest.approx([14.4002, 50.0997], abs=1e-4)
    kml = client.get(f"{url}/export.kml").text
    assert "&lt;b&gt; &amp; co" in kml
    assert "on it" in kml


def test_exports_for_the_earth_name_the_floors_of_notes_and_photos(client, url):
    write(client, url, title="Yard")
    assert '<ExtendedData><Data name="floor">' not in client.get(f"{url}/export.kml").text
    client.post(f"{url}/floors", data={"name": "Gallery <1>", "level": "1"})
    write(client, url, title="Lift", floor=1)
    kml = ElementTree.fromstring(client.get(f"{url}/export.kml").data)
    floors = {
        mark.findtext("k:name", namespaces=KML): {
            data.get("name"): data.findtext("k:value", namespaces=KML)
            for data in mark.iterfind("k:ExtendedData/k:Data", KML)
        }
        for mark in kml.iterfind(".//k:Placemark", KML)
    }
    assert floors["Lift"] == {"floor": "Gallery <1>", "level": "1.0"}
    assert (floors["Yard"]["floor"], floors["Yard"]["level"]) == ("Ground floor", "0.0")
    (photo,) = (floors[name] for name in floors if name not in ("Lift", "Yard"))
    assert photo["floor"] == "Ground floor"


def test_a_share_shows_notes_only_where_it_is_allowed(client, url, stranger):
    write(client, url)
    client.patch(f"{url}/experiences/0", json={"note": "on it"})
    for allowed in (False, True):
        share = client.post(f"{url}/shares", json={"notes": allowed}).json
        assert share["notes"] is allowed
        seen = stranger.get(f"/api/v1/shared/{share['url'].rsplit('/', 1)[1]}").json
        assert [note["title"] for note in seen["notes"]] == (["Bench"] if allowed else [])
        assert seen["photos"][0]["note"] == ("on it" if allowed else None)


@pytest.mark.parametrize(
    "broken",
    [
        {"notes": [{"id": 1, "title": ""}]},
        {"notes": [{"id": 1, "title": "a", "x_px": 3}]},
        {"notes": [{"id": 1, "title": "a"}, {"id": 1, "title": "b"}]},
        {"experiences": [{"id": 1, "photo": "a.jpg", "note": "a\x00"}]},
    ],
)
def test_damaged_notes_of_a_file_are_refused(broken):
    with pytest.raises(MapJsonError):
        parse_map_json(json.dumps({"format": "experience-map", "version": 1, **broken}).encode())
