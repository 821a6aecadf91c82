"""Floors through the API: added, changed, aligned, removed, undone; photos on them; export and import."""

import io
import json

import numpy as np
import pytest
from PIL import Image
from sqlalchemy import select

from tests.web.maps.images import CORNERS, png
from webapp.errors import MapJsonError
from webapp.files.maps.map_json import parse_map_json
from webapp.store.schema import Photo
from webapp.tasks.exchange.import_map import import_map
from webapp.tasks.maps.export import export_late_maps


@pytest.fixture
def url(client, park):
    """The address of a map with two photos, one of them placed."""
    url = f"/api/v1/maps/{park}"
    satellite = {"file": (png(), "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"{url}/satellite", data=satellite).status_code == 200
    for n in range(2):
        client.post(f"{url}/photos", data={"file": (png((40 + n, 30)), f"{n}.png")})
    assert place(client, url, 0, 50, 100).status_code == 200
    return url


def place(client, url, id, x, y, **more):
    change = {"id": id, "x_px": x, "y_px": y, **more}
    return client.patch(f"{url}/experiences", json={"kind": "place", "changes": [change]})


def add(client, url, *, size=(150, 100), colour="red", **fields):
    wish = {"name": "1st floor", "level": 1, **fields}
    if size:
        wish["file"] = (png(size, colour), "plan.png")
    return client.post(f"{url}/floors", data=wish)


def floors(client, url):
    return client.get(f"{url}/floors").json["floors"]


def photo(client, url, id):
    return next(photo for photo in client.get(url).json["photos"] if photo["id"] == id)


def files(library, park):
    export_late_maps(library)
    cfg = library.cfg(park)
    return cfg.read_bytes(), json.loads(cfg.with_name("map.json").read_bytes())


def test_a_floor_is_added_shown_renamed_removed_and_each_step_undone(client, url):
    assert floors(client, url) == []
    answer = add(client, url, height_m=4.5)
    assert answer.status_code == 201, answer.text
    base, first = answer.json["floors"]
    assert (base["id"], base["name"], base["level"], base["url"]) == (0, "Ground floor", 0.0, None)
    assert (first["id"], first["level"], first["height_m"]) == (1, 1.0, 4.5)
    shown = client.get(first["url"], buffered=True)
    assert "immutable" in shown.headers["Cache-Control"]
    pixels = np.asarray(Image.open(io.BytesIO(shown.data)).convert("RGB"))
    assert pixels.shape[:2] == (100, 150)
    assert np.abs(pixels[50, 75].astype(int) - (255, 0, 0)).max() < 10

    assert client.patch(f"{url}/floors/1", json={"name": "Attic", "level": 2}).status_code == 200
    assert [f["name"] for f in floors(client, url)] == ["Ground floor", "Attic"]
    assert client.delete(f"{url}/floors/1").json["floors"] == []
    for wanted in (["Ground floor", "Attic"], ["Ground floor", "1st floor"], []):
        assert client.post(f"{url}/undo").status_code == 200
        assert [f["name"] for f in floors(client, url)] == wanted


def test_floors_are_listed_from_below_and_may_share_the_image_of_the_map(client, url):
    add(client, url, base_name="Street", base_level=0.5)
    cellar = add(client, url, size=None, name="Cellar", level=-1)
    assert [f["name"] for f in cellar.json["floors"]] == ["Cellar", "Street", "1st floor"]
    assert cellar.json["floors"][0]["url"] is None
    assert client.get(f"{url}/floors/2/image").status_code == 404


def test_photos_are_placed_and_moved_on_floors(client, url):
    add(client, url)
    assert place(client, url, 1, 60, 70, floor=1).json["photos"][0]["floor"] == 1
    moved = client.patch(f"{url}/experiences", json={"kind": "floor", "changes": [{"id": 0, "floor": 1}]})
    assert (moved.json["photos"][0]["floor"], moved.json["undo"]["kind"]) == (1, "floor")
    client.post(f"{url}/undo")
    assert photo(client, url, 0)["floor"] == 0
    tray = client.patch(f"{url}/experiences/1", json={"x_px": None, "y_px": None})
    assert tray.json["photos"][0]["floor"] == 0
    assert place(client, url, 1, 60, 70, floor=7).status_code == 400


def test_leaving_a_further_placement_is_not_leaving_the_floor(client, url):
    add(client, url)
    place(client, url, 1, 60, 70, floor=1)
    client.put(f"{url}/placements/parts", json={"clusters_px": 50})
    left = {"placement": "parts", "changes": [{"id": 1, "x_px": None, "y_px": None}]}
    assert client.patch(f"{url}/experiences", json=left).status_code == 200
    assert (photo(client, url, 1)["x_px"], photo(client, url, 1)["floor"]) == (60, 1)
    (parts,) = client.get(url).json["placements"]
    assert "1" not in parts["positions"]


def test_a_new_image_without_the_place_of_a_photo_takes_it_off_its_floor(client, url):
    add(client, url)
    place(client, url, 1, 290, 190, floor=1)
    small = {"file": (png((100, 100)), "s.png"), "tray": "1"}
    assert client.put(f"{url}/satellite", data=small).status_code == 200
    assert (photo(client, url, 1)["x_px"], photo(client, url, 1)["floor"]) == (None, 0)


def test_clusters_are_gathered_on_each_floor_by_itself(client, url):
    add(client, url)
    place(client, url, 1, 60, 100, floor=1)
    client.put(f"{url}/placements/parts", json={"clusters_px": 50})
    (parts,) = client.get(url).json["placements"]
    assert parts["positions"] == {"0": [50, 100], "1": [60, 100]}


def test_a_floor_with_photos_is_removed_only_with_them(client, url):
    add(client, url)
    place(client, url, 1, 60, 70, floor=1)
    refused = client.delete(f"{url}/floors/1")
    assert (refused.status_code, refused.json["error"]["message"]) == (400, "1 photos are on this floor")
    assert client.delete(f"{url}/floors/1?tray=1").status_code == 200
    assert (photo(client, url, 1)["x_px"], photo(client, url, 1)["floor"]) == (None, 0)
    client.post(f"{url}/undo")
    assert (photo(client, url, 1)["x_px"], photo(client, url, 1)["floor"]) == (60, 1)


def test_what_others_have_put_on_a_floor_keeps_it(client, url, library, park):
    add(client, url)
    place(client, url, 1, 60, 70, floor=1)
    client.post(f"{url}/undo")  # the placing
    client.post(f"{url}/undo")  # the floor
    assert floors(client, url) == []
    client.post(f"{url}/redo")
    client.post(f"{url}/redo")
    assert photo(client, url, 1)["floor"] == 1


@pytest.fixture
def other(client, url, new_account, sign_in):
    """The browser of another editor of the map."""
    ben = new_account("Ben")
    assert client.post(f"{url}/members", json={"name": "Ben", "role": "editor"}).status_code in (200, 201)
    return sign_in(ben)


def test_an_undo_never_leaves_two_floors_of_one_level(client, url, other):
    add(client, url)
    client.patch(f"{url}/floors/1", json={"level": 2})
    assert add(other, url, size=None, name="Mezzanine", level=1).status_code == 201
    refused = client.post(f"{url}/undo")
    assert refused.status_code == 409
    assert "the floors have been changed in the meantime" in refused.json["error"]["message"]
    assert [(f["name"], f["level"]) for f in floors(client, url)] == [
        ("Ground floor", 0), ("Mezzanine", 1), ("1st floor", 2)
    ]  # fmt: skip


def test_a_redo_never_leaves_two_floors_of_one_level(client, url, other):
    add(client, url)
    client.patch(f"{url}/floors/1", json={"level": 2})
    client.post(f"{url}/undo")
    assert add(other, url, size=None, name="Attic", level=2).status_code == 201
    assert client.post(f"{url}/redo").status_code == 409
    assert [f["level"] for f in floors(client, url)] == [0, 1, 2]


def test_the_undo_of_the_first_floor_never_leaves_further_ones_without_it(client, url, other):
    add(client, url)
    assert add(other, url, size=None, name="Attic", level=2).status_code == 201
    assert client.post(f"{url}/undo").status_code == 409
    assert [f["id"] for f in floors(client, url)] == [0, 1, 2]


def test_the_undo_of_a_floor_is_refused_where_somebody_has_placed_a_photo_on_it(client, url, other):
    add(client, url)
    assert place(other, url, 1, 60, 70, floor=1).status_code == 200
    refused = client.post(f"{url}/undo")
    assert refused.status_code == 409
    assert "photos were placed on the floor in the meantime" in refused.json["error"]["message"]
    assert photo(client, url, 1)["floor"] == 1


def test_a_photo_does_not_come_back_to_a_floor_that_somebody_has_removed(client, url, other):
    add(client, url)
    place(client, url, 1, 60, 70, floor=1)
    client.patch(f"{url}/experiences", json={"kind": "floor", "changes": [{"id": 1, "floor": 0}]})
    assert other.delete(f"{url}/floors/1").status_code == 200
    refused = client.post(f"{url}/undo")
    assert refused.status_code == 409
    assert "the floor has been removed in the meantime" in refused.json["error"]["message"]
    assert photo(client, url, 1)["floor"] == 0


@pytest.mark.parametrize(
    "wish",
    [
        {"name": ""},
        {"name": "x" * 61},
        {"name": "a\nb"},
        {"level": "nan"},
        {"level": 1001},
        {"level": 0},
        {"height_m": "inf"},
    ],
)
def test_what_is_no_floor_is_refused_and_changes_nothing(client, url, library, park, wish):
    before = sorted(path.name for path in library.map_folder(park).iterdir())
    assert 400 <= add(client, url, **wish).status_code < 500
    assert floors(client, url) == []
    assert sorted(path.name for path in library.map_folder(park).iterdir()) == before


def test_a_file_that_is_no_image_is_refused(client, url):
    wish = {"name": "1st floor", "level": 1, "file": (io.BytesIO(b"no image"), "plan.png")}
    answer = client.post(f"{url}/floors", data=wish)
    assert 400 <= answer.status_code < 500
    assert floors(client, url) == []


def test_the_floor_of_the_maps_image_stays(client, url):
    add(client, url)
    assert client.delete(f"{url}/floors/0").status_code == 400
    assert client.put(f"{url}/floors/0/image", data={"file": (png(), "p.png")}).status_code == 400
    assert client.delete(f"{url}/floors/5").status_code == 404


def test_an_image_is_aligned_by_pairs_of_spots_and_its_photos_go_along(client, url, library, park):
    add(client, url)
    place(client, url, 1, 60, 70, floor=1, heading_deg=350)

    def align(*pairs):
        wish = [{"shown": shown, "wanted": wanted} for shown, wanted in pairs]
        return client.post(f"{url}/floors/1/align", json={"pairs": wish})

    def laid():
        return files(library, park)[1]["floors"][1]["image"]["map_from_image"]

    assert laid() == [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
    assert align(([10, 10], [20, 15])).status_code == 200
    assert laid() == [[2.0, 0.0, 10.0], [0.0, 2.0, 5.0]]
    moved = photo(client, url, 1)
    assert (moved["x_px"], moved["y_px"], moved["heading_deg"]) == (70, 75, 350)
    client.post(f"{url}/undo")
    assert photo(client, url, 1)["x_px"] == 60
    # a quarter turn clockwise about (60, 70), twice as large
    assert align(([60, 70], [60, 70]), ([70, 70], [60, 90])).status_code == 200
    assert np.allclose(laid(), [[0, -4, 200], [4, 0, -50]])
    assert photo(client, url, 1)["heading_deg"] == pytest.approx(80)
    line = [([n, n], [n, n]) for n in (1, 2, 3)]
    assert align(*line).status_code == 400
    assert align(([5, 5], [5, 5]), ([5, 5], [9, 9])).status_code == 400
    assert "would be moved off the map" in align(([0, 0], [290, 0])).json["error"]["message"]
    corner = np.asarray(Image.open(io.BytesIO(client.get(floors(client, url)[1]["url"], buffered=True).data)))
    assert (corner[0, -1, 3], corner[corner.shape[0] // 2, corner.shape[1] // 8, 3]) == (0, 255)


def test_removed_photos_are_aligned_with_their_floor(client, url, library):
    add(client, url)
    for id, x in ((0, 100), (1, 290)):
        place(client, url, id, x, 50, floor=1)
        assert client.delete(f"{url}/experiences/{id}").status_code == 200
    shifted = {"pairs": [{"shown": [0, 0], "wanted": [40, 10]}]}
    assert client.post(f"{url}/floors/1/align", json=shifted).status_code == 200
    with library.database.read() as session:
        rows = session.scalars(select(Photo).order_by(Photo.id)).all()
        assert [(p.removed, p.x_px, p.y_px, p.floor) for p in rows] == [
            (True, 140, 60, 1), (True, None, None, 0)  # the second one would be outside the map
        ]  # fmt: skip


def test_a_new_image_of_the_map_takes_the_floors_along(client, url, library, park):
    add(client, url)
    larger = {"file": (png((600, 400)), "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"{url}/satellite", data=larger).status_code == 200
    assert np.allclose(
        files(library, park)[1]["floors"][1]["image"]["map_from_image"], [[4, 0, 0], [0, 4, 0]], atol=1e-6
    )


def test_the_files_without_floors_have_no_word_of_them(client, url, library, park):
    before = files(library, park)[0]
    assert b"floor" not in library.cfg(park).with_name("map.json").read_bytes()
    add(client, url)
    client.patch(f"{url}/experiences", json={"kind": "floor", "changes": [{"id": 0, "floor": 1}]})
    after, known = files(library, park)
    assert after == before
    assert [e["floor"] for e in known["experiences"] if e["id"] == 0] == [1]
    assert [f["name"] for f in known["floors"]] == ["Ground floor", "1st floor"]


def test_a_zip_brings_floors_back(client, url, library, owner, settings, tmp_path):
    add(client, url, height_m=4.5)
    place(client, url, 1, 60, 70, floor=1)
    archive = tmp_path / "park.zip"
    archive.write_bytes(client.get(f"{url}/export.zip").data)
    made = import_map(library, archive, account_id=owner.id, name="Copy", settings=settings)
    assert not made.findings and not made.left_out
    copy = f"/api/v1/maps/{made.slug}"
    assert [(f["name"], f["height_m"]) for f in floors(client, copy)] == [
        ("Ground floor", None), ("1st floor", 4.5)
    ]  # fmt: skip
    assert photo(client, copy, 1)["floor"] == 1
    shown = client.get(floors(client, copy)[1]["url"], buffered=True)
    assert Image.open(io.BytesIO(shown.data)).size == (150, 100)


@pytest.mark.parametrize(
    "floors",
    [
        [{"id": 1, "name": "1st", "level": 1}],
        [{"id": 0, "name": "A", "level": 1}, {"id": 1, "name": "B", "level": 1}],
        [{"id": 0, "name": "", "level": 0}],
        [{"id": 0, "name": "A", "level": 0, "image": {}}],
        [{"id": 0, "name": "A", "level": 0}, {"id": 1, "name": "B", "level": 2, "image": {
            "path": "../x.png", "width": 1, "height": 1, "map_from_image": [[1, 0, 0], [0, 1, 0]]}}],
        [{"id": 0, "name": "A", "level": 0}, {"id": 1, "name": "B", "level": 2, "image": {
            "path": "x.png", "width": 1, "height": 1, "map_from_image": [[1, 1, 0], [1, 1, 0]]}}],
    ],
)  # fmt: skip
def test_floors_that_are_none_are_refused_in_map_json(floors):
    data = json.dumps({"format": "experience-map", "version": 1, "floors": floors}).encode()
    with pytest.raises(MapJsonError, match="floors"):
        parse_map_json(data)


def test_a_photo_on_a_floor_that_is_not_there_is_refused_in_map_json():
    experiences = [{"id": 0, "photo": "a.jpg", "floor": 3}]
    content = {"format": "experience-map", "version": 1, "experiences": experiences}
    with pytest.raises(MapJsonError, match="floor 3"):
        parse_map_json(json.dumps(content).encode())


def test_what_was_changed_in_the_files_is_taken_over(client, url, library, park):
    add(client, url)
    cfg, known = files(library, park)
    known["floors"][1]["name"] = "Gallery"
    known["experiences"] = [e for e in known["experiences"] if e["id"] != 0]
    line = cfg.decode().splitlines()[1].split(";")
    known["experiences"].append({"id": 0, "photo": line[1], "floor": 1})
    line[2] = str(int(line[2]) + 9)
    path = library.cfg(park)
    path.with_name("map.json").write_text(json.dumps(known))
    path.write_text("\n".join([cfg.decode().splitlines()[0], ";".join(line)]) + "\n")
    shown = client.get(f"{url}/outside-edit").json
    assert (shown["floors"], [one["id"] for one in shown["moved"]]) == (["Gallery"], [0])
    assert client.post(f"{url}/outside-edit/take", json={"sha256": shown["sha256"]}).status_code == 200
    assert [f["name"] for f in floors(client, url)] == ["Ground floor", "Gallery"]
    assert (photo(client, url, 0)["x_px"], photo(client, url, 0)["floor"]) == (59, 1)
    client.post(f"{url}/undo")
    assert (photo(client, url, 0)["x_px"], photo(client, url, 0)["floor"]) == (50, 0)


def test_a_photo_that_was_renamed_outside_stays_on_its_floor(client, url, library, park):
    add(client, url)
    place(client, url, 0, 50, 100, floor=1)
    cfg, _ = files(library, park)
    path = library.cfg(park)
    first, line = cfg.decode().splitlines()
    name = line.split(";")[1]
    (path.parent / name).rename(path.parent / "renamed.png")
    path.write_text(f"{first}\n{line.replace(name, 'renamed.png')}\n")
    shown = client.get(f"{url}/outside-edit").json
    assert client.post(f"{url}/outside-edit/take", json={"sha256": shown["sha256"]}).status_code == 200
    taken = photo(client, url, 0)
    assert (taken["x_px"], taken["floor"]) == (50, 1)
