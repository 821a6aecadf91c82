"""The fixtures of the web application, a map and a mission."""

import json

import pytest

from tests.web.conftest import (
    app,
    client,
    library,
    new_account,
    owner,
    settings,
    sign_in,
    stranger,
)
from webapp.missions.store import missions
from webapp.missions.tasks import store_batch
from webapp.missions.tasks.store_batch import Numbered
from webapp.tasks.maps import adopt_map

__all__ = ["app", "client", "library", "new_account", "owner", "settings", "sign_in", "stranger"]

NOON = 1714564800.0  # 2024-05-01T12:00:00Z
ABOUT = {
    "format": "experience-map",
    "version": 1,
    "georeference": {
        "plane": "EPSG:4326",
        "plane_from_pixel": [[1e-5, 0, 14.0], [0, -1e-5, 50.0], [0, 0, 1]],
        "method": "corners",
    },
    "experiences": [
        {"id": n, "photo": f"{n}.jpg", "x_px": 10.0 * n + 0.5, "y_px": 20.0, "heading_deg": 90.0,
         **({} if n == 4 else {"taken_at": f"2026-05-0{n + 1}T12:00:00+02:00"})}
        for n in range(5)
    ],
    "notes": [
        {"id": 1, "title": "Bench", "x_px": 10.0, "y_px": 20.0, "photos": [0, 3]},
        {"id": 2, "title": "Lost", "text": "Its place is unknown."},
    ],
}  # fmt: skip


@pytest.fixture
def park(library, owner, save_photo):
    """A map with five photos and two notes."""
    folder = library.map_folder("park-2")
    folder.mkdir(parents=True)
    for n in range(5):
        save_photo(folder / f"{n}.jpg", n)
    save_photo(folder / "plan.png", 9)
    lines = "".join(f"{n};{n}.jpg;{10 * n + 1};20\n" for n in range(5))
    (folder / "map.cfg").write_text(f"plan.png;320;240\n{lines}")
    (folder / "map.json").write_text(json.dumps(ABOUT))
    adopt_map.adopt_map(library, "park-2", account_id=owner.id)
    return "map-park-2"


@pytest.fixture
def search(library, owner):
    """A mission of two tracks, one of them over the 180th meridian, and three objects."""
    with library.database.write() as session:
        id = missions.create(session, "Search", account_id=owner.id, map_id=None).id
    records = [
        {"type": "pose", "source": source, "time": NOON + n + later, "lat": lat, "lon": lon + n}
        for source, lat, lon, later in (("gps", 50.0, 14.0, 0.0), ("odometry", 0.0, 179.5, 3600.0))
        for n in range(2)
    ]
    for record in records:
        record["lon"] -= 360.0 * (record["lon"] > 180.0)
    records += [
        {"type": "object", "id": id_, "class": "car", "time": NOON + n, "lat": 50.0 + n, "lon": 14.0}
        for n, id_ in enumerate(("a", "b/1 ü", "c"))
    ]
    store_batch.store_batch(library, id, records=records, place=Numbered("robot", 0))
    return f"mission-{id}"
