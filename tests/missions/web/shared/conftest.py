"""Missions on the server with data sent as by robots."""

import io

import piexif
import pytest
from PIL import Image

BEGIN = 1_777_629_600.0
"""2026-05-01T10:00:00Z."""


@pytest.fixture
def stranger(stranger):
    """A visitor, who reads each response to its end and closes it."""
    real = stranger.get

    def get(*args, **options):
        answer = real(*args, **options)
        answer.get_data()
        answer.close()
        return answer

    stranger.get = get
    return stranger


@pytest.fixture
def send(client):
    """Send poses and objects to a mission."""

    def send(mission, poses=0, *, first=0, objects=()):
        way = range(first, first + poses)
        records = [
            {"type": "pose", "time": BEGIN + n / 2, "lat": 50.0, "lon": 14 + n * 1e-5, "heading_deg": 90.0}
            for n in way
        ]
        records += [
            {"type": "object", "id": id, "class": kind, "time": BEGIN, "lat": 50.001, "lon": 14.0}
            for id, kind in objects
        ]
        key = {"Idempotency-Key": f"{first}-{poses}-{len(objects)}"}
        answer = client.post(f"/api/v1/missions/{mission}/batches", json={"records": records}, headers=key)
        assert answer.status_code == 200, answer.text

    return send


@pytest.fixture
def new_mission(client, send):
    """Make a mission with some poses and two objects and return its id."""

    def make(poses=10, **wish):
        wish = {"name": "Search", "note": "SECRETNOTE", **wish}
        answer = client.post("/api/v1/missions", json=wish)
        assert answer.status_code == 201, answer.text
        id = answer.json["id"]
        send(id, poses, objects=[("c1", "car"), ("v1", "victim")])
        return id

    return make


@pytest.fixture
def add_photo(client):
    """Send a photo with EXIF to a mission and return its SHA-256."""

    def add(mission):
        exif = piexif.dump({"0th": {piexif.ImageIFD.Make: b"SECRETCAM"}})
        file = io.BytesIO()
        Image.new("RGB", (64, 48), "green").save(file, "JPEG", exif=exif)
        file.seek(0)
        data = {"file": (file, "SECRETNAME.jpg"), "object": "c1"}
        answer = client.post(f"/api/v1/missions/{mission}/photos", data=data)
        assert answer.status_code == 201, answer.text
        return answer.json["sha256"]

    return add


@pytest.fixture
def share(client):
    """Share a mission and return the answer to its owner."""

    def make(mission, **wish):
        answer = client.post(f"/api/v1/missions/{mission}/shares", json=wish)
        assert answer.status_code == 201, answer.text
        return answer.json

    return make
