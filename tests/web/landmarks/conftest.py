"""A map with an image, whose photos are placed or in its tray, and one with landmarks."""

import io

import numpy as np
import pytest
from PIL import Image

from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.core.landmarks.submodels import Submodel
from webapp.files.landmarks.cloud import CLOUD_FILE, COLOURS_FILE, StoredCloud, write_cloud, write_colours
from webapp.files.landmarks.colmap import SUBMODELS_FILE, StoredSubmodels, write_submodels
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.localize.index_location import landmarks_folder

AT = [(10, 10), (200, 40), (120, 220)]
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Camera-from-world rotation, facing the top of the image; the world is map pixels with y and z up."""


def jpeg(number):
    file = io.BytesIO()
    Image.new("RGB", (40, 30), (20 * number, 0, 0)).save(file, "JPEG")
    return file.getvalue()


def place(client, url, id, *, at):
    changes = [{"id": id, "x_px": at[0], "y_px": at[1]}]
    answer = client.patch(f"{url}/experiences", json={"kind": "place", "changes": changes})
    assert answer.status_code == 200


@pytest.fixture
def yard(client, library, park):
    """The address of a map with an image, one placed photo and three in the tray, and its slug."""
    slug = park
    library.map_folder(slug).mkdir()
    Image.new("RGB", (400, 300)).save(library.map_folder(slug) / "plan.png")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        record.satellite_path, record.satellite_width, record.satellite_height = "plan.png", 400, 300
    url = f"/api/v1/maps/{slug}"
    for number in range(4):
        data = {"file": (io.BytesIO(jpeg(number)), f"{number}.jpg")}
        assert client.post(f"{url}/photos", data=data).status_code == 207
    place(client, url, 0, at=(10, 10))
    return url, slug


def add_landmarks(cfg, contents):
    """Write landmarks that three photos see, which are placed at `AT`."""
    folder = landmarks_folder(cfg)
    folder.mkdir(parents=True)
    centre = np.array([(x, -y, 0.0) for x, y in AT], float)
    point = np.array([(50.0, -60.0, 5.0), (150.0, -100.0, -3.0), (90.0, -20.0, 8.0), (30.0, -150.0, 0.0)])
    write_submodels(
        folder / SUBMODELS_FILE,
        StoredSubmodels((Submodel(np.arange(3), centre, np.tile(UP, (3, 1, 1))),), contents, "key"),
    )
    cloud = LandmarkCloud(
        contents,
        point,
        np.zeros(4, np.int32),
        np.array([0, 4, 8, 12]),
        np.tile(np.arange(4, dtype=np.int32), 3),
        np.zeros((12, 2), np.float32),
        np.zeros((12, 128), np.uint8),
        np.full(3, 30.0),
        np.zeros(3),
    )
    write_cloud(folder / CLOUD_FILE, StoredCloud(cloud, "key"))
    write_colours(folder / COLOURS_FILE, np.arange(12, dtype=np.uint8).reshape(4, 3), key="key")


@pytest.fixture
def joined(yard, client, library):
    """The map with three placed photos and landmarks that all of them see, and its record."""
    url, slug = yard
    for id, at in enumerate(AT):
        place(client, url, id, at=at)
    with library.database.read() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        contents = tuple(
            session.query(Photo).filter_by(map_id=record.id, id=n).one().sha256 for n in range(3)
        )
    add_landmarks(library.cfg(slug), contents)
    return f"{url}/landmarks", record
