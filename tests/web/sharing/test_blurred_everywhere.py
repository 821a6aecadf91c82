"""Whatever is blurred is blurred in everything that the server gives out, from the moment of the answer."""

import base64
import inspect
import io
import re
import zipfile

import numpy as np
import pytest
from PIL import Image

from tests.web.landmarks.conftest import AT, add_landmarks
from tests.web.sharing.stripes import BOX, blur, stripes
from webapp.files.part_file import sha256_of
from webapp.render import export_file
from webapp.settings import Settings
from webapp.store import queries
from webapp.store.maps import maps
from webapp.store.schema import Photo, QueryRecord
from webapp.tasks.landmarks.show_cloud import align_in_library

MEMBER, VISITOR, OTHER = "member", "visitor", "member of another map"
ANSWERS = ("same", "adopted", "older")
TEXTS = ("kml", "geojson", "xmp", "csv")

ROUTES = {
    "api_photos.thumb": [(MEMBER, "/api/v1/maps/{slug}/photos/0/thumb", "blurred")],
    "api_photos.preview": [
        (MEMBER, "/api/v1/maps/{slug}/photos/0/preview", "blurred"),
        (OTHER, "/api/v1/maps/{other}/photos/0/preview", "sharp"),
    ],
    "api_photos.original": [(MEMBER, "/api/v1/maps/{slug}/photos/0/original", "sharp")],
    "api_queries.thumb": [(MEMBER, "/api/v1/maps/{slug}/queries/{same}/thumb", "blurred")],
    "api_queries.preview": [
        (MEMBER, "/api/v1/maps/{slug}/queries/{same}/preview", "blurred"),
        (MEMBER, "/api/v1/maps/{slug}/queries/{adopted}/preview", "blurred"),
        (MEMBER, "/api/v1/maps/{slug}/queries/{older}/preview", "blurred"),
    ],
    "api_queries.photo": [(MEMBER, "/api/v1/maps/{slug}/queries/{same}/photo", "sharp")],
    "api_localize.example": [(MEMBER, "/api/v1/maps/{slug}/examples/q.jpg", "sharp")],
    "api_localize.example_thumb": [(MEMBER, "/api/v1/maps/{slug}/examples/q.jpg/thumb", "blurred")],
    "api_exchange.export": [
        (MEMBER, "/api/v1/maps/{slug}/export.kmz", "blurred"),
        (MEMBER, "/api/v1/maps/{slug}/export.html", "blurred"),
        (OTHER, "/api/v1/maps/{other}/export.kmz", "blurred"),
        (MEMBER, "/api/v1/maps/{slug}/export.zip", "sharp"),
        (MEMBER, "/api/v1/maps/{slug}/export.exif", "sharp"),
        *((MEMBER, f"/api/v1/maps/{{slug}}/export.{form}", "none") for form in TEXTS),
    ],
    "api_exchange.exported": [(MEMBER, "/api/v1/maps/{slug}/exports/{slug}.kmz", "gone")],
    "api_print.print_sheet": [(MEMBER, "/api/v1/maps/{slug}/print.png?labels=names", "none")],
    "api_mission_photos.thumb": [(MEMBER, "/api/v1/missions/{mission}/photos/{sha}/thumb", "blurred")],
    "api_mission_photos.preview": [(MEMBER, "/api/v1/missions/{mission}/photos/{sha}/preview", "blurred")],
    "api_mission_photos.original": [(MEMBER, "/api/v1/missions/{mission}/photos/{sha}/original", "sharp")],
    "api_mission_exports.export_mission": [
        (MEMBER, "/api/v1/missions/{mission}/export.kmz", "blurred"),
        (MEMBER, "/api/v1/missions/{mission}/export.html", "none"),
        (MEMBER, "/api/v1/missions/{mission}/export.report.html", "blurred"),
    ],
    "public_mission_pages.export": [
        (VISITOR, "/m/{of_mission}/export.kmz", "none"),
        (VISITOR, "/m/{of_mission}/export.html", "none"),
        (VISITOR, "/m/{of_mission}/export.report.html", "blurred"),
    ],
    "api_shared.photo_thumb": [(VISITOR, "/api/v1/shared/{of_map}/photos/0/thumb", "blurred")],
    "api_shared.photo_preview": [
        (VISITOR, "/api/v1/shared/{of_map}/photos/0/preview", "blurred"),
        (VISITOR, "/api/v1/shared/{of_same}/photos/0/preview", "blurred"),
        (VISITOR, "/api/v1/shared/{of_other}/photos/0/preview", "blurred"),
    ],
    "api_shared.photo_original": [
        (VISITOR, "/api/v1/shared/{of_map}/photos/0/original", "gone"),
        (VISITOR, "/api/v1/shared/{of_other}/photos/0/original", "gone"),
    ],
    "api_shared.query_thumb": [
        (VISITOR, f"/api/v1/shared/{{of_{name}}}/query/thumb", "blurred") for name in ANSWERS
    ],
    "api_shared.query_preview": [
        (VISITOR, f"/api/v1/shared/{{of_{name}}}/query/preview", "blurred") for name in ANSWERS
    ],
    "api_shared.query_original": [
        (VISITOR, f"/api/v1/shared/{{of_{name}}}/query/original", "gone") for name in ANSWERS
    ],
    "api_shared_missions.photo_thumb": [
        (VISITOR, "/api/v1/shared-missions/{of_mission}/photos/{sha}/thumb", "blurred")
    ],
    "api_shared_missions.photo_preview": [
        (VISITOR, "/api/v1/shared-missions/{of_mission}/photos/{sha}/preview", "blurred")
    ],
    "api_shared_cloud.ply": [(VISITOR, "/api/v1/shared/{of_map}/landmarks/points.ply", "gone")],
    "api_shared_cloud.points": [(VISITOR, "/api/v1/shared/{of_map}/landmarks/points/{key}/0", "gone")],
    "api_cloud.ply": [(MEMBER, "/api/v1/maps/{slug}/landmarks/points.ply", "none")],
    "api_cloud.points": [(MEMBER, "/api/v1/maps/{slug}/landmarks/points/{key}/0", "none")],
}
"""How to call each route that may give pixels of a photo, who does, and what they get after the blur.

`blurred`: pictures, in none of which the stripes are left; `sharp`: the file, for members; `none`: never a
picture of a photo; `gone`: status 404.
"""

WITHOUT_PHOTOS = {
    "images of maps and tiles": (
        "api_satellite.get_image api_satellite.get_thumbnail api_satellite.get_tile "
        "api_satellite.service_tile api_floors.image api_shared.image api_shared.tile api_shared.floor_image "
        "api_shared_missions.image api_shared_missions.tile"
    ),
    "map files and tables": (
        "api_exchange.cfg api_exchange.placement_cfg api_plan.walk api_queries.export "
        "api_mission_exports.objects api_mission_exports.network_link api_mission_exports.query "
        "public_mission_pages.network_link public_mission_pages.objects api_mission_events.events "
        "api_geopackage.export_map api_geopackage.export_mission "
        "api_geopackage.export_map_project api_geopackage.export_mission_project"
    ),
    "drawings of tags": "api_control_points.print_sheet",
    "a drawing of tracks": "api_mission_fixes.fusion_picture",
    "keypoints, cameras and names: see tests/web/landmarks": "api_cloud.colmap api_shared_cloud.colmap",
    "the program itself": (
        "static static_files.bundle static_files.favicon installable.manifest installable.service_worker "
        "manual_pages.index manual_pages.picture metrics.show map_pages.show map_pages.show_slash "
        "sign_in.form sign_in.link code_pages.form oidc.start oidc.callback passkeys.start"
    ),
}


def test_every_route_that_sends_a_file_is_in_the_table(app):
    """If this fails for a new route: say above how to call it, or why it sends no pixels of a photo."""
    known = {*ROUTES, *(name for names in WITHOUT_PHOTOS.values() for name in names.split())}
    endpoints = {rule.endpoint for rule in app.url_map.iter_rules() if "GET" in rule.methods}
    views = {name: inspect.unwrap(app.view_functions[name]) for name in endpoints}
    assert known == {
        name for name, view in views.items() if "Response" in str(view.__annotations__.get("return"))
    }


def pictures_in(data):
    """Yield the pictures in a file: itself, or those in an archive or a page."""
    if data.startswith((b"\xff\xd8", b"\x89PNG", b"RIFF")):
        yield data
    elif data.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in archive.namelist():
                yield from pictures_in(archive.read(name))
    else:
        for found in re.findall(rb"data:image/(?:jpeg|png|webp);base64,([A-Za-z0-9+/=]+)", data):
            yield from pictures_in(base64.b64decode(found))


def has_stripes(picture):
    """Return whether the columns in the middle of a picture are in turn dark and bright."""
    grey = np.asarray(Image.open(io.BytesIO(picture)).convert("L"), float)
    height, width = grey.shape
    middle = grey[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]
    return np.abs(np.diff(middle, axis=1)).mean() > 60


def seen(answer):
    """Return what an answer shows of the stripes, and how many pictures it has."""
    if answer.status_code == 404:
        return "gone", 0
    assert answer.status_code == 200, answer.request.path
    found = [has_stripes(picture) for picture in pictures_in(answer.get_data())]
    return "sharp" if any(found) else "none", len(found)


@pytest.fixture
def other(sign_in, new_account, new_map, fill_map):
    """A map of somebody else that has the same photo, and a browser of that person."""
    ana = new_account("Ana")
    browser = sign_in(ana)
    return browser, fill_map(browser, new_map(ana, name="Other"))


@pytest.fixture
def answers(library, full, owner):
    """Ids of answers: to the same file, to another that was adopted, and of an older version."""
    form = {
        "query": "q.jpg",
        "fov_deg": None,
        "fov_source": None,
        "hypotheses": [{"rank": 1, "x_px": 15.0, "y_px": 20.0, "experiences": [0], "probability": 0.9}],
        "off_map_probability": 0.1,
        "other_probability": 0.0,
    }
    facts = {
        "options": {},
        "evidence": [],
        "width": 160,
        "height": 120,
        "account_id": owner.id,
        "answer": form,
    }
    files = {"same": stripes(), "adopted": stripes(90), "older": stripes()}
    ids = {}
    with library.database.write() as session:
        record = maps.find(session, full, account=owner)
        folder = queries.folder(library, record.id)
        folder.mkdir(parents=True)
        for name, data in files.items():
            (folder / f"{name}.jpg").write_bytes(data)
            row = QueryRecord(name="q.jpg", file=f"{name}.jpg", **facts)
            row.sha256 = None if name == "older" else sha256_of(folder / f"{name}.jpg")
            row.adopted_id = 0 if name == "adopted" else None
            queries.add(session, record, row=row, most=9)
            ids[name] = row.id
    return ids


@pytest.fixture
def mission(client):
    """A mission with the same photo of an object: its id, and the SHA-256 of the photo."""
    id = client.post("/api/v1/missions", json={"name": "Search"}).json["id"]
    record = {"type": "object", "id": "c1", "class": "car", "time": 1.7e9, "lat": 50.0, "lon": 14.0}
    key = {"Idempotency-Key": "1"}
    answer = client.post(f"/api/v1/missions/{id}/batches", json={"records": [record]}, headers=key)
    assert answer.status_code == 200, answer.text
    data = {"file": (io.BytesIO(stripes()), "m.jpg"), "object": "c1"}
    return id, client.post(f"/api/v1/missions/{id}/photos", data=data).json["sha256"]


@pytest.fixture
def key(client, library, full, owner):
    """The key of landmarks of the map, which three photos see."""
    for number in range(1, len(AT)):
        file = io.BytesIO()
        Image.new("RGB", (40, 30), (90 * number, 0, 0)).save(file, "JPEG")
        file.seek(0)
        client.post(f"/api/v1/maps/{full}/photos", data={"file": [(file, f"{number}.jpg")]})
    changes = [{"id": id, "x_px": x, "y_px": y} for id, (x, y) in enumerate(AT)]
    assert client.patch(f"/api/v1/maps/{full}/experiences", json={"changes": changes}).status_code == 200
    with library.database.read() as session:
        record = maps.find(session, full, account=owner)
        rows = [session.get_one(Photo, (record.id, id)) for id in range(len(AT))]
        add_landmarks(library.cfg(full), tuple(row.sha256 for row in rows))
    align_in_library(library, record)
    return client.get(f"/api/v1/maps/{full}/landmarks").json["key"]


@pytest.fixture
def values(client, library, full, owner, other, answers, mission, key):
    """Whatever is named in the addresses of the table; everything is shared."""

    def token(browser, address, **wish):
        answer = browser.post(f"/api/v1/{address}/shares", json={"photos": True, **wish})
        assert answer.status_code == 201, answer.text
        return answer.json["url"].rpartition("/")[2]

    example = library.map_folder(full) / "queries" / "q.jpg"
    example.parent.mkdir()
    example.write_bytes(stripes())
    with library.database.read() as session:
        record = maps.find(session, full, account=owner)
    download = export_file.export_map_file(library, record.id, form="kmz", settings=Settings())
    export_file.keep(library, full, download=download, blurring=export_file.blurring_of(library, record))
    browser, slug = other
    return {
        "slug": full,
        "other": slug,
        "mission": mission[0],
        "sha": mission[1],
        "key": key,
        "of_map": token(client, f"maps/{full}", originals=True, landmarks=True),
        "of_other": token(browser, f"maps/{slug}", originals=True),
        "of_mission": token(client, f"missions/{mission[0]}"),
        **answers,
        **{
            f"of_{name}": token(client, f"maps/{full}", originals=True, query=id)
            for name, id in answers.items()
        },
    }


@pytest.fixture
def look(client, stranger, other, values):
    """Call every address of the table, and return what is seen there, as by a browser with a cache."""
    browsers, cached = {MEMBER: client, VISITOR: stranger, OTHER: other[0]}, {}

    def fetch(who, address):
        tag, before = cached.get((who, address), (None, None))
        with browsers[who].get(
            address.format(**values), headers={"If-None-Match": tag} if tag else {}
        ) as answer:
            found = before if answer.status_code == 304 else seen(answer)
            cached[who, address] = answer.headers.get("ETag"), found
            return found

    return lambda: {
        (who, address): fetch(who, address) for calls in ROUTES.values() for who, address, _ in calls
    }


def test_what_is_blurred_is_blurred_wherever_it_is_seen(client, full, look):
    wanted = {(who, address): after for calls in ROUTES.values() for who, address, after in calls}
    before = look()
    sharp = {call for call, after in wanted.items() if after != "none" and "landmarks" not in call[1]}
    assert {call for call, (found, _) in before.items() if found == "sharp"} == sharp
    assert not [call for call, (found, _) in before.items() if found == "gone"]
    assert blur(client, full, BOX).status_code == 200
    after = look()
    assert {call: found for call, (found, _) in after.items()} == {
        call: "none" if expected == "blurred" else expected for call, expected in wanted.items()
    }
    assert [call for call in wanted if wanted[call] != "gone" and after[call][1] != before[call][1]] == []
