"""A map with an image, whose photos are placed or in its tray."""

import io

import pytest
from PIL import Image

from webapp.store.schema import MapRecord


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
    """The address of a map with an image, a placed photo, and three photos in the tray; and its slug."""
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
