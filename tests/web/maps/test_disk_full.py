"""A full disk or database gives a 507 in the usual form, and nothing is lost or left behind."""

import errno
import io
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from sqlalchemy import event

from webapp.settings import UploadLimits
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import adopt_map
from webapp.tasks.maps.export import export_late_maps

IMAGE_SEED, PHOTO_SEED = 1, 2


@pytest.fixture
def settings(settings):
    return replace(settings, upload=UploadLimits(reserve_mb=0.0))


@pytest.fixture
def park(library, owner, make_map):
    """The slug of a map with three placed photos."""
    make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    return "park"


@pytest.fixture
def disk(monkeypatch):
    """A switch that makes the disk full: writes fail."""
    real, full = os.fsync, [True]

    def fsync(handle):
        if full[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    return full


@pytest.fixture
def database(library):
    """A switch that keeps the database from growing."""
    full = [True]

    def limit(connection, _record, _proxy):
        connection.execute("PRAGMA cache_size=2")
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count={pages if full[0] else 10**9}")

    event.listen(library.database.engine, "checkout", limit)
    return full


def jpeg(seed, side=120):
    pixels = np.random.default_rng(seed).integers(0, 255, (side, side, 3)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG")
    return file.getvalue()


def files(seed, name="a.jpg", **fields):
    return {"data": {"file": (io.BytesIO(jpeg(seed)), name), **fields}}


def upload(client):
    """Send the only chunk of a photo."""
    about = {"name": "u.jpg", "size_bytes": len(jpeg(PHOTO_SEED)), "fingerprint": "u"}
    begun = client.post("/api/v1/maps/park/uploads", json=about)
    if begun.status_code != 201:
        return begun
    path, headers = f"/api/v1/maps/park/uploads/{begun.json['id']}", {"Upload-Offset": "0"}
    return client.patch(path, data=jpeg(PHOTO_SEED), headers=headers)


WRITERS = {
    "photos": lambda c: c.post("/api/v1/maps/park/photos", **files(PHOTO_SEED)),
    "upload": upload,
    "image": lambda c: c.put("/api/v1/maps/park/satellite", **files(IMAGE_SEED, tray="true")),
    "blank": lambda c: c.post("/api/v1/maps/park/satellite/blank", json={"width": 500, "height": 300}),
    "localize": lambda c: c.post("/api/v1/maps/park/localize", **files(PHOTO_SEED)),
    "import": lambda c: c.post("/api/v1/maps/import", **files(PHOTO_SEED, "a.zip")),
    "positions": lambda c: c.post("/api/v1/maps/park/positions", **files(PHOTO_SEED, "a.csv")),
}


def error_of(answer):
    """Return the error of a response: of its first item (207), or of the whole."""
    if answer.status_code == 207:
        return answer.json[0]["error"]
    assert answer.status_code in (503, 507), answer.text
    assert set(answer.json) == {"error"}
    return answer.json["error"]


def state(library):
    """Return the state of the map and its photos, and all files except locks and computed ones."""
    with library.database.read() as session:
        record = session.query(MapRecord).filter_by(slug="park").one()
        rows = session.query(Photo).filter_by(map_id=record.id).order_by(Photo.id)
        known = [(p.id, p.name, p.x_px, p.removed) for p in rows]
    every = [p for p in library.folder.rglob("*") if p.is_file() and p.suffix != ".lock"]
    kept = sorted(
        str(p) for p in every if not {"derived"} & set(p.parts) and not p.name.startswith("library.db")
    )
    return record.revision, record.satellite_path, known, kept


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_full_disk(write, client, library, park, disk):
    client.get("/")  # creates the key of the sessions
    before = state(library)
    error = error_of(write(client))
    assert error["code"] == "disk_full" and error["hint"]
    assert str(library.folder) not in str(error)
    assert state(library) == before
    disk[0] = False
    again = write(client)
    assert again.status_code != 507 and "disk_full" not in again.text


CHANGES = {
    "create": lambda c: c.post("/api/v1/maps", json={"name": "x" * 100}),
    "place": lambda c: c.patch(
        "/api/v1/maps/park/experiences",
        json={"changes": [{"id": id, "x_px": 5.5, "y_px": 6.5} for id in range(3)]},
    ),
    "placement": lambda c: c.put("/api/v1/maps/park/placements/other", json={}),
    "job": lambda c: c.post("/api/v1/maps/park/exports", json={"format": "zip"}),
    "photos": WRITERS["photos"],
    "image": WRITERS["image"],
    "blank": WRITERS["blank"],
    "duplicate": lambda c: c.post("/api/v1/maps/park/duplicate", json={}),
}


def fill(client):
    """Send small requests until the database is full."""
    for number in range(200):
        answer = client.post("/api/v1/maps", json={"name": f"{number:03}" + "x" * 100})
        if answer.status_code != 201:
            return answer
    raise AssertionError("the database is never full")


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_full_database(change, client, library, park, database):
    error = error_of(fill(client))
    assert error["code"] == "disk_full"
    assert str(library.folder) not in str(error)
    before = state(library)
    answer = change(client)
    if answer.status_code == 507 or "disk_full" in answer.text:  # a small row may still have found space
        assert error_of(answer)["code"] == "disk_full"
        assert state(library)[:3] == before[:3]
    assert client.get("/api/v1/maps/park").status_code == 200
    database[0] = False
    assert change(client).status_code < 400
    with library.database.read() as session:
        assert session.connection().exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"


def test_an_edit_whose_files_cannot_be_written_is_safe_all_the_same(client, library, park, disk):
    """The database is authoritative: it has the edit, and the worker writes the files when there is space."""
    path, place = "/api/v1/maps/park/experiences/0", {"x_px": 7.0, "y_px": 8.0}
    cfg = library.cfg("park").read_bytes()
    answer = client.patch(path, json=place)
    assert answer.status_code == 200
    assert client.get("/api/v1/maps/park").json["photos"][0]["x_px"] == 7.0
    assert not export_late_maps(library)
    assert library.cfg("park").read_bytes() == cfg
    disk[0] = False
    assert export_late_maps(library)
    assert "0;photos/0.jpg;7;8" in library.cfg("park").read_text()


def test_a_bug_is_not_taken_for_a_full_disk(app, client, monkeypatch):
    app.testing = False

    def broken(*_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("webapp.web.maps.api_maps.maps.list_maps", broken)
    assert client.get("/api/v1/maps").status_code == 500


@pytest.fixture
def read_only(library, monkeypatch):
    """A switch that makes the library read-only, like a disk after an error."""
    real, refused = os.fsync, [True]

    def fsync(handle):
        if refused[0]:
            raise OSError(errno.EROFS, "Read-only file system")
        real(handle)

    def refuse(connection, _record, _proxy):
        connection.execute(f"PRAGMA query_only={int(refused[0])}")

    monkeypatch.setattr(os, "fsync", fsync)
    event.listen(library.database.engine, "checkout", refuse)
    return refused


@pytest.mark.parametrize("change", [*WRITERS.values(), *CHANGES.values()], ids=[*WRITERS, *CHANGES])
def test_a_library_that_turns_read_only_while_it_is_served(change, client, library, park, read_only):
    read_only[0] = False
    client.get("/")
    before = state(library)
    read_only[0] = True
    error = error_of(change(client))
    assert str(library.folder) not in str(error)
    assert client.get("/api/v1/maps/park").status_code == 200, "what is there is shown"
    assert state(library) == before
    read_only[0] = False
    again = change(client)
    assert again.status_code < 500 and not re.search("read.?only", again.text, re.IGNORECASE)
