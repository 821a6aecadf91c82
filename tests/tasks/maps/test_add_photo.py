"""Adding a file: checked, stored once, placed by its GPS, whatever happens in between."""

import hashlib
import io
import math
import shutil
import threading
import zlib
from datetime import datetime
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import EnuMetres, LatLon
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import DiskFull, ExpMapError, NotFound, PhotoError
from webapp.files import part_file
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.settings import PhotoLimits, Settings, UploadLimits
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.schema import Account, MapRecord, Photo
from webapp.tasks.maps import add_photo, photo_files, placing
from webapp.tasks.maps.add_photo import IncomingPhoto

HERE = LatLon(50.08, 14.42)


def jpeg(seed=0, *, size=(320, 240), **options):
    """Return a JPEG with structure."""
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1] // 8, size[0] // 8, 3)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).resize(size).save(file, "JPEG", **options)
    return file.getvalue()


def at(east, north, **fields):
    """Return the EXIF of a photo at an offset in metres from the middle of the image."""
    position = LocalFrame(HERE).latlon_of(EnuMetres(east, north))
    return exif_bytes(
        CameraTags(
            taken_at=datetime(2026, 5, 1, 12), focal_35mm=26, position=position, accuracy_m=4.0, **fields
        )
    )


class Desk:
    """A library with one map, and functions to add files."""

    def __init__(self, folder):
        self.library = open_library(folder)
        with self.library.database.write() as session:
            account = Account(name="ana", is_owner=True)
            session.add(account)
            session.flush()
            self.account_id = account.id
            self.map_id = maps.create(session, "Park", account_id=account.id).id
        self.folder = self.library.map_folder("park")
        self.count = 0

    def give(self, data, name="IMG_1.jpg", *, id=None, settings=None, **options):
        """Put a file into the uploads folder and add it."""
        self.count += 1
        source = self.library.uploads / f"{self.count}.part"
        source.write_bytes(data)
        incoming = IncomingPhoto(source, name, id)
        return add_photo.add_photo(
            self.library, self.map_id, photo=incoming, settings=settings or Settings(), **options
        )

    def georeference(self):
        """Give the map an image of 1000 x 800 pixels, 0.1 m each, north 30 degrees right of up."""
        turn = math.radians(30)
        c, s = 0.1 * math.cos(turn), 0.1 * math.sin(turn)
        rows = [[c, -s, -500 * c + 400 * s], [-s, -c, 500 * s + 400 * c], [0.0, 0.0, 1.0]]
        plane = LocalFrame(HERE).plane
        Georeference(plane, tuple(v for row in rows for v in row), "corners")
        with self.library.database.write() as session:
            record = session.get(MapRecord, self.map_id)
            record.satellite_path, record.satellite_width, record.satellite_height = "plan.png", 1000, 800
            record.georeference = {"plane": plane, "plane_from_pixel": rows, "method": "corners"}

    def rows(self):
        """All photos of the map."""
        with self.library.database.read() as session:
            return maps.photos(session, session.get(MapRecord, self.map_id))

    def files(self):
        """Return the names in the photo folder."""
        return sorted(path.name for path in self.folder.glob("photos/*"))


@pytest.fixture
def desk(tmp_path):
    desk = Desk(tmp_path / "library")
    yield desk
    desk.library.database.close()


def test_a_photo_is_kept_unchanged(desk):
    data = jpeg(exif=exif_bytes(CameraTags(taken_at=datetime(2026, 5, 1, 12), focal_35mm=26)))
    intake = desk.give(data, "výlet do lesa (2).JPG")
    (row,) = desk.rows()
    assert (intake.id, intake.duplicate, intake.placed) == (row.id, False, False)
    assert row.name == "výlet do lesa (2).JPG"
    assert row.path == "photos/výlet do lesa (2).JPG"
    assert (desk.folder / row.path).read_bytes() == data
    assert (row.width, row.height, row.size_bytes) == (320, 240, len(data))
    assert row.taken_at == "2026-05-01T12:00:00"
    assert row.fov_deg == pytest.approx(67.4, abs=1)
    assert not list(desk.library.uploads.iterdir())


def test_previews_are_small_upright_and_say_nothing(desk):
    exif = Image.Exif()
    exif[0x0112] = 6
    exif[0x010F] = "Secret Maker"
    desk.give(jpeg(size=(2400, 1200), exif=exif))
    sizes = {}
    for path in desk.folder.glob("derived/previews/*"):
        with Image.open(path) as image:
            sizes[path.name] = image.size
            assert not image.getexif()
        assert b"Secret" not in path.read_bytes()
    assert sizes == {"0-1600.jpg": (800, 1600), "0-256.webp": (128, 256)}


def test_a_photo_is_refused_as_a_whole_where_its_previews_cannot_be_kept(desk, monkeypatch):
    def full(*_args, **_more):
        raise DiskFull("full")

    monkeypatch.setattr(add_photo, "write_previews", full)
    with pytest.raises(DiskFull):
        desk.give(jpeg())
    assert desk.rows() == []
    monkeypatch.undo()
    desk.give(jpeg())
    assert len(desk.rows()) == len(desk.files()) == 1


@pytest.mark.parametrize(
    "name",
    ["../../../etc/passwd", "..\\..\\x.jpg", "/etc/shadow", "C:\\CON", "a\0b.jpg", "", " ", ".", "..",
     "x" * 5000, "\ud800.jpg", "<script>.jpg", "a;b\n1;c.jpg;0;0", "日本語.jpg", "-rf.jpg", "a/b/c.jpg",
     ".htaccess", "a.php"],
)  # fmt: skip
def test_no_name_leads_anywhere(desk, name):
    desk.give(jpeg(), name)
    (row,) = desk.rows()
    (file,) = desk.files()
    assert row.path == f"photos/{file}"
    assert file.endswith(".jpg") and not set(file) & set(";/\\:<>\n\0") and file[0] not in " .-"
    assert name_problem(row.path) is None and len(file) <= 100
    assert 0 < len(row.name) <= 300
    everything = {p.relative_to(desk.folder).parts[0] for p in desk.folder.rglob("*")}
    assert everything == {"photos", "derived"}


def test_the_ending_is_that_of_the_content(desk):
    file = io.BytesIO()
    pillow_heif.from_pillow(Image.open(io.BytesIO(jpeg()))).save(file)
    desk.give(file.getvalue(), "really.jpg")
    assert Path(desk.rows()[0].path).suffix == ".heic"
    assert (desk.folder / desk.rows()[0].path).read_bytes() == file.getvalue()
    assert (desk.folder / "derived/previews/0-256.webp").exists()


def bomb():
    """Return a PNG that claims 60000 x 60000 pixels."""

    def chunk(kind, data):
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    header = (60000).to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
    pixels = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'><script/></svg>", "not an image"),
        (b"%PDF-1.7", "not an image"),
        (jpeg()[:-2000], "the file is damaged, or its end is missing"),
        (jpeg()[:100], "cannot be read|damaged|not an image"),
        (bomb(), "megapixels|pixels"),
    ],
)
def test_a_file_that_is_not_a_photo_is_refused_by_name(desk, data, says):
    with pytest.raises(PhotoError, match=says) as caught:
        desk.give(data, "mine.jpg")
    assert caught.value.where == "mine.jpg"
    assert str(desk.library.folder) not in str(caught.value)
    assert (desk.rows(), desk.files()) == ([], [])


def test_a_photo_over_the_limits_is_refused(desk):
    for limits in (PhotoLimits(max_mb=0.001), PhotoLimits(max_megapixels=0.01)):
        with pytest.raises(PhotoError, match="more than the limit"):
            desk.give(jpeg(), settings=Settings(photo=limits))


def test_photos_of_one_name_have_files_of_their_own(desk):
    names = ["IMG_1.jpg", "sub/IMG_1.jpg", "img_1.JPG", "Č.jpg", "č.jpg", "IMG_1.jpeg"]
    for number, name in enumerate(names):
        desk.give(jpeg(number), name)
    rows = desk.rows()
    assert [row.name for row in rows] == names
    plain = [row.path for row in rows if row.sha256[:8] not in row.path]
    assert plain == ["photos/IMG_1.jpg", "photos/Č.jpg", "photos/IMG_1.jpeg"]
    assert len({row.path.casefold() for row in rows}) == len(names) == len(desk.files())
    assert all(
        row.path.startswith(("photos/IMG_1-", "photos/img_1-", "photos/č-"))
        for row in rows
        if row.path not in plain
    )


def test_a_reserved_id_is_the_photos(desk):
    with desk.library.database.write() as session:
        record = session.get(MapRecord, desk.map_id)
        first, second = (maps.reserve_id(record) for _ in range(2))
    assert desk.give(jpeg(1), id=second).id == second
    assert desk.give(jpeg(0), id=first).id == first
    assert desk.give(jpeg(2)).id == second + 1


def test_the_same_content_comes_once(desk):
    first = desk.give(jpeg(), "a.jpg")
    again = desk.give(jpeg(), "b.jpg")
    assert (again.id, again.duplicate) == (first.id, True)
    assert len(desk.files()) == 1
    assert not list(desk.library.uploads.iterdir())


def test_a_removed_photo_comes_back(desk):
    intake = desk.give(jpeg(), "a.jpg")
    with desk.library.database.write() as session:
        session.get(Photo, (desk.map_id, intake.id)).removed = True
    again = desk.give(jpeg(), "a.jpg")
    assert (again.id, again.duplicate) == (intake.id, False)
    assert not desk.rows()[0].removed


def test_the_same_file_at_once_is_one_photo(desk):
    data, results = [jpeg(0), jpeg(1)], []

    def bring(number):
        source = desk.library.uploads / f"t{number}.part"
        source.write_bytes(data[number % 2])
        incoming = IncomingPhoto(source, f"{number}.jpg")
        results.append(add_photo.add_photo(desk.library, desk.map_id, photo=incoming, settings=Settings()))

    threads = [threading.Thread(target=bring, args=(n,)) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(r.duplicate for r in results) == [False] * 2 + [True] * 6
    assert {r.id for r in results} == {0, 1} == {row.id for row in desk.rows()}
    assert {f"photos/{name}" for name in desk.files()} == {row.path for row in desk.rows()}


def test_a_file_of_an_interrupted_intake_is_used_again_or_swept(desk, monkeypatch):
    def killed(*_arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(
            photo_files, "move_in", lambda source, target: (part_file.move_in(source, target), killed())
        )
        for seed in (0, 1):
            with pytest.raises(KeyboardInterrupt):
                desk.give(jpeg(seed), f"{seed}.jpg")
    (desk.folder / "photos" / "own.jpg").write_bytes(jpeg(7))
    assert (desk.rows(), len(desk.files())) == ([], 3)
    desk.give(jpeg(0), "0.jpg")
    assert len(desk.files()) == 3
    assert photo_files.sweep_orphans(desk.library, desk.map_id) == 1
    assert [f"photos/{name}" for name in desk.files()] == [desk.rows()[0].path, "photos/own.jpg"]
    assert not list(desk.folder.glob("derived/intake/*"))
    monkeypatch.setattr(desk.library.database, "write", killed)
    assert photo_files.sweep_orphans(desk.library, desk.map_id) == 0, "and nobody has to wait for it"


def test_another_file_under_the_name_is_not_replaced(desk):
    digits = hashlib.sha256(jpeg()).hexdigest()
    (desk.folder / "photos").mkdir(parents=True)
    taken = [desk.folder / "photos" / name for name in ("a.jpg", f"a-{digits[:8]}.jpg")]
    for path in taken:
        path.write_bytes(b"someone else's")
    desk.give(jpeg(), "a.jpg")
    assert desk.rows()[0].path == f"photos/a-{digits[:16]}.jpg"
    assert [path.read_bytes() for path in taken] == [b"someone else's"] * 2


def test_a_full_disk_leaves_nothing(desk, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(part_file, "sync_folder", full)
    with pytest.raises(DiskFull, match="No space left"):
        desk.give(jpeg())
    assert desk.rows() == []


def test_a_photo_with_gps_is_placed_by_itself(desk):
    desk.georeference()
    intake = desk.give(jpeg(exif=at(-20.0, 10.0, heading_deg=90.0)))
    (row,) = desk.rows()
    assert intake.placed and intake.gps_problem is None
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    right, down = -20 * c - 10 * s, 20 * s - 10 * c
    assert (row.x_px, row.y_px) == pytest.approx((500 + right / 0.1, 400 + down / 0.1), abs=0.1)
    assert (row.heading_deg, row.gps_accuracy_m) == pytest.approx((90.0, 4.0))


def test_a_photo_outside_the_image_says_how_far(desk):
    desk.georeference()
    intake = desk.give(jpeg(exif=at(500.0, 0.0)))
    assert not intake.placed
    assert "beyond the" in intake.gps_problem
    assert desk.rows()[0].gps_problem is None


@pytest.mark.parametrize(
    ("maker", "says"), [(None, "any other EXIF"), ("Apple", "iOS leaves it out"), ("Samsung", "Android")]
)
def test_a_photo_without_gps_says_what_helps(desk, maker, says):
    exif = Image.Exif()
    if maker:
        exif[0x010F] = maker
    intake = desk.give(jpeg(exif=exif))
    assert says in intake.gps_problem
    assert desk.rows()[0].gps_problem == intake.gps_problem


def test_the_tray_is_placed_once_the_georeference_is_known(desk):
    inside, _, _ = (desk.give(jpeg(n, exif=at(x, 0.0))) for n, x in enumerate((5.0, 900.0, 0.0)))
    desk.give(jpeg(3))
    with pytest.raises(ExpMapError, match="no satellite image"):
        placing.place_by_gps(desk.library, desk.map_id, account_id=desk.account_id)
    desk.georeference()
    result = placing.place_by_gps(desk.library, desk.map_id, account_id=desk.account_id)
    assert result.placed == (inside.id, 2)
    assert [(o.id, "beyond" in o.reason) for o in result.outside] == [(1, True)]
    again = placing.place_by_gps(desk.library, desk.map_id, account_id=desk.account_id)
    assert again.placed == ()


def test_a_map_that_is_gone_takes_nothing(desk):
    desk.map_id += 1
    with pytest.raises(NotFound):
        desk.give(jpeg())


def test_every_odd_photo_is_taken_or_refused_in_a_sentence(desk, shared_data):
    shutil.rmtree(desk.folder, ignore_errors=True)
    taken = 0
    for path in sorted((shared_data / "odd_photos").iterdir()):
        try:
            intake = desk.give(path.read_bytes(), path.name)
        except PhotoError as error:
            assert error.where == path.name
        else:
            taken += not intake.duplicate
    assert taken == len(desk.files()) == len(desk.rows()) > 20


def test_old_uploads_are_given_up(desk):
    stale = desk.library.uploads / "0123.part"
    stale.write_bytes(b"half")
    assert photo_files.sweep_uploads(desk.library, settings=Settings()) == 0
    assert (
        photo_files.sweep_uploads(desk.library, settings=Settings(upload=UploadLimits(keep_hours=0.0))) == 1
    )
    assert not stale.exists()
