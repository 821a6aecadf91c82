"""A folder of photos becomes a map; every file is accounted for."""

from pathlib import Path

import cv2
import numpy as np
import piexif
import pytest
from PIL import Image
from pyproj import Geod

from tests.geopackages import point, write_package
from tests.tasks.maps.test_cut_panoramas import POSE, XMP, panorama
from webapp.core.boxes import BlurBox
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.geometry.tilt import Tilt
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import Cancelled, MapError, UsageError
from webapp.files.maps.folder import read_map
from webapp.files.photos.exif_write import Geotag, format_xmp
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.tasks.maps import check_map, from_photos
from webapp.tasks.maps.from_photos import PanoramaOptions, PlaceOptions
from webapp.tasks.maps.place_photos import FileState
from webapp.tasks.satellite.georeference import GeoSource

CORNERS = '{"top_left": {"lat": 50.001, "lon": 14.0}, "bottom_right": {"lat": 50.0, "lon": 14.002}}'
"""Corners of an image of 400 x 310 pixels of 0.36 m."""


def rationals(degrees):
    return ((int(degrees), 1), (0, 1), (round((degrees - int(degrees)) * 3600 * 10**6), 10**6))


def photo(path, lat=None, lon=None, *, camera=None, gps=None):
    tags = {} if lat is None else {1: b"N", 2: rationals(lat), 3: b"E", 4: rationals(lon)}
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = piexif.dump({"Exif": camera or {}, "GPS": {**tags, **(gps or {})}})
    colour = tuple(hash(path.name) >> shift & 255 for shift in (0, 8, 16))
    Image.new("RGB", (36, 24), colour).save(path, "JPEG", exif=exif)


@pytest.fixture
def folder(tmp_path) -> Path:
    """A satellite image with its corners, three photos with GPS, and all kinds of invalid files."""
    Image.new("RGB", (400, 310), (60, 90, 50)).save(tmp_path / "sat.png")
    (tmp_path / "corners.json").write_text(CORNERS)
    photos = tmp_path / "photos"
    photo(
        photos / "img2.jpg", 50.0005, 14.001,
        camera={0xA405: 18, 0x9003: b"2024:05:01 10:20:30"},
        gps={16: b"T", 17: (905, 10), 31: (4, 1)},
    )  # fmt: skip
    photo(photos / "img10.jpg", 50.0009, 14.0001, gps={16: b"M", 17: (10, 1)})
    photo(photos / "deep" / "é photo.jpg", 50.0001, 14.0019)
    photo(photos / "none.jpg")
    photo(photos / "zero.jpg", 0.0, 0.0)
    photo(photos / "far.jpg", 50.0005, 14.003)
    whole = (photos / "img2.jpg").read_bytes()
    (photos / "broken.jpg").write_bytes(whole[: len(whole) * 3 // 4])
    (photos / "notes.txt").write_text("no photo")
    return tmp_path


def run(folder, cfg=None, *, photos="photos", progress=None, settings=None, **options):
    options = PlaceOptions(cfg or folder / "map.cfg", **options)
    return from_photos.map_from_photos(
        folder / photos, options=options, settings=settings or Settings(), progress=progress or Progress()
    )


def on_image(folder, **options):
    source = GeoSource("corners", folder / "corners.json")
    return run(folder, satellite=folder / "sat.png", source=source, **options)


def states(report):
    return {file.name: file.state for file in report.files}


def test_every_file_is_accounted_for(folder):
    report = on_image(folder)
    assert [(file.name, file.state) for file in report.files] == [
        ("broken.jpg", FileState.UNREADABLE),
        ("deep/é photo.jpg", FileState.PLACED),
        ("far.jpg", FileState.OUTSIDE),
        ("img2.jpg", FileState.PLACED),
        ("img10.jpg", FileState.PLACED),
        ("none.jpg", FileState.NO_POSITION),
        ("notes.txt", FileState.NOT_A_PHOTO),
        ("zero.jpg", FileState.NO_POSITION),
    ]
    reasons = {file.name: file.reason for file in report.files}
    assert "no GPS" in reasons["none.jpg"]
    assert "0 N 0 E" in reasons["zero.jpg"]
    assert reasons["broken.jpg"]
    assert reasons["img2.jpg"] is None
    # 0.001 degrees of longitude east of the right edge
    metres = Geod(ellps="WGS84").inv(14.002, 50.0005, 14.003, 50.0005)[2]
    assert reasons["far.jpg"] == f"200 px ({metres:.3g} m) beyond the right edge"
    assert report.written
    assert report.count(FileState.PLACED) == 3


def test_the_map_holds_what_the_photos_say(folder):
    report = on_image(folder)
    map_ = read_map(folder / "map.cfg")
    assert (folder / "map.cfg").read_text(encoding="utf-8") == (
        "sat.png;400;310\n"
        "0;photos/deep/é photo.jpg;380;279\n"
        "1;photos/img2.jpg;200;155\n"
        "2;photos/img10.jpg;20;31\n"
    )
    e = map_.experiences[1]
    assert e.position == pytest.approx((200, 155), abs=1e-3)
    assert (e.heading_deg, e.gps_accuracy_m, e.taken_at) == (90.5, 4.0, "2024-05-01T10:20:30")
    assert e.fov_deg == pytest.approx(90)
    assert map_.georeference.latlon_of(e.position) == pytest.approx((50.0005, 14.001), abs=1e-9)
    assert map_.next_id == 3
    assert [file.experience for file in report.files if file.experience] == list(map_.experiences)
    assert "magnetic" in next(file for file in report.files if file.name == "img10.jpg").notes[0]
    assert check_map.check_map(folder / "map.cfg", settings=Settings(), progress=Progress()).errors == 0


def test_a_blank_plan_is_made_around_the_positions(folder):
    report = run(folder)
    map_ = read_map(folder / "map.cfg")
    assert report.count(FileState.PLACED) == 4
    assert report.count(FileState.OUTSIDE) == 0
    assert map_.satellite.path == "plan.png"
    plan = cv2.imread(str(folder / "plan.png"))
    assert plan.shape == (map_.satellite.height, map_.satellite.width, 3)
    far = next(e for e in map_.experiences if e.photo == "photos/far.jpg")
    assert map_.georeference.latlon_of(far.position) == pytest.approx((50.0005, 14.003), abs=1e-8)


def test_lund_is_placed_in_full(shared_data, tmp_path):
    report = run(shared_data / "lund", tmp_path / "new" / "map.cfg", copy=True)
    assert (report.count(FileState.PLACED), len(report.files)) == (29, 29)
    map_ = read_map(tmp_path / "new" / "map.cfg")
    assert all((tmp_path / "new" / e.photo).is_file() for e in map_.experiences)
    for file in report.files:
        assert map_.georeference.latlon_of(file.experience.position) == pytest.approx(file.latlon, abs=1e-8)


def test_every_odd_photo_is_accounted_for(shared_data, tmp_path):
    Image.new("RGB", (720, 320)).save(tmp_path / "world.png")
    corners = '{"top_left": {"lat": 80, "lon": -180}, "bottom_right": {"lat": -80, "lon": 180}}'
    (tmp_path / "corners.json").write_text(corners)
    source = GeoSource("corners", tmp_path / "corners.json")
    image = {"satellite": tmp_path / "world.png", "source": source}
    report = run(shared_data, tmp_path / "map.cfg", photos="odd_photos", copy=True, **image)
    names = {path.name for path in (shared_data / "odd_photos").iterdir()}
    assert {file.name for file in report.files} == names
    assert (report.count(FileState.PLACED), report.count(FileState.NO_POSITION)) == (6, 26)
    assert all(bool(file.reason) != (file.state is FileState.PLACED) for file in report.files)


def test_photos_of_two_cities_are_not_put_on_one_blank_plan(tmp_path):
    photo(tmp_path / "photos" / "prague.jpg", 50.0, 14.0)
    photo(tmp_path / "photos" / "brno.jpg", 49.0, 16.0)
    photo(tmp_path / "photos" / "zlin.jpg", 49.0, 17.0)
    with pytest.raises(UsageError, match=r"spread over 217 km, from prague.jpg to zlin.jpg") as refused:
        run(tmp_path)
    assert "a map of each place" in refused.value.hint
    assert not (tmp_path / "map.cfg").exists()


@pytest.mark.parametrize("count", [1, 3])
def test_a_blank_plan_of_one_place(tmp_path, count):
    for i in range(count):
        photo(tmp_path / "photos" / f"{i}.jpg", 50.0, 14.0)
    assert run(tmp_path).count(FileState.PLACED) == count


@pytest.mark.parametrize("satellite", [True, False])
def test_no_map_is_written_without_a_photo_on_it(folder, satellite):
    for path in (folder / "photos").rglob("*.jpg"):
        if path.name not in ("none.jpg", "far.jpg") or (path.name == "far.jpg" and not satellite):
            path.unlink()
    before = sorted(folder.rglob("*"))
    report = on_image(folder) if satellite else run(folder)
    assert not report.written
    assert sorted(folder.rglob("*")) == before
    assert states(report)["none.jpg"] == FileState.NO_POSITION


def test_an_existing_map_is_never_overwritten(folder):
    (folder / "map.cfg").write_text("precious")
    for make in (on_image, run):
        with pytest.raises(UsageError, match="exists"):
            make(folder)
    with pytest.raises(MapError):
        on_image(folder, force=True)
    assert (folder / "map.cfg").read_text() == "precious"
    (folder / "map.cfg").unlink()
    (folder / "plan.png").write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        run(folder)
    assert on_image(folder).written


def test_a_replaced_map_keeps_ids_and_uses_none_again(folder):
    on_image(folder)
    (folder / "photos" / "img2.jpg").unlink()
    photo(folder / "photos" / "a new one.jpg", 50.0002, 14.0002)
    on_image(folder, force=True)
    map_ = read_map(folder / "map.cfg")
    assert {e.photo: e.id for e in map_.experiences} == {
        "photos/deep/é photo.jpg": 0,
        "photos/img10.jpg": 2,
        "photos/a new one.jpg": 3,
    }
    assert (map_.next_id, map_.revision) == (4, 1)


def test_the_map_s_own_files_are_no_photos(folder):
    first = run(folder, photos=".")
    assert states(first)["sat.png"] == FileState.NO_POSITION
    second = on_image(folder, cfg=folder / "other.cfg", photos=".")
    assert states(second)["sat.png"] == FileState.NOT_A_PHOTO
    again = run(folder, photos=".", force=True)
    assert states(again)["plan.png"] == FileState.NOT_A_PHOTO
    assert not any("derived" in name for name in states(again))


def test_photos_must_be_inside_the_maps_folder_or_copied(folder, tmp_path):
    cfg = tmp_path / "elsewhere" / "deep" / "map.cfg"
    with pytest.raises(UsageError, match="photos lie outside") as caught:
        on_image(folder, cfg=cfg)
    assert "--copy" in caught.value.hint
    assert not cfg.parent.exists()
    assert on_image(folder, cfg=cfg, copy=True).written
    map_ = read_map(cfg)
    assert map_.satellite.path == "sat.png"
    for name in ["sat.png", *(e.photo for e in map_.experiences)]:
        assert (cfg.parent / name).read_bytes() == (folder / name).read_bytes()
    assert not (cfg.parent / "photos" / "none.jpg").exists()


def test_a_copy_replaces_no_other_file(folder, tmp_path):
    cfg = tmp_path / "elsewhere" / "map.cfg"
    (cfg.parent / "photos").mkdir(parents=True)
    (cfg.parent / "photos" / "img2.jpg").write_bytes(b"precious")
    with pytest.raises(UsageError, match="another file"):
        on_image(folder, cfg=cfg, copy=True)
    assert (cfg.parent / "photos" / "img2.jpg").read_bytes() == b"precious"
    assert not cfg.exists()


def test_the_image_must_be_inside_the_maps_folder(folder):
    cfg = folder / "photos" / "map.cfg"
    with pytest.raises(UsageError, match="satellite image lies outside"):
        on_image(folder, cfg=cfg)
    assert on_image(folder, cfg=cfg, copy=True).satellite.path == "sat.png"


@pytest.mark.parametrize(
    "table",
    [
        "name;lat;lon\nimg10.jpg;50.0005;14.001\nnone.jpg;50.0005;14.001\n",
        "name;x;y\nphotos/img10.jpg;200;155\nwherever/none.jpg;200;155\n",
    ],
)
def test_positions_by_name_come_instead_of_exif(folder, table):
    (folder / "list.csv").write_text(table)
    report = on_image(folder, positions=folder / "list.csv")
    placed = {f.name: f.experience for f in report.files if f.experience}
    assert set(placed) == {"img10.jpg", "none.jpg"}
    assert placed["none.jpg"].position == pytest.approx((200, 155), abs=1e-6)
    assert placed["none.jpg"].gps_accuracy_m is None
    assert "not in the list of positions" in next(f.reason for f in report.files if f.name == "img2.jpg")


def test_positions_and_notes_from_a_geopackage(folder):
    rows = [(point(14.001, 50.0005), "", "DCIM/img10.jpg", 90.0, "By the gate.")]
    report = on_image(folder, positions=write_package(folder / "survey.gpkg", rows))
    (placed,) = (f.experience for f in report.files if f.experience)
    assert (placed.heading_deg, placed.note) == (90.0, "By the gate.")
    assert placed.position == pytest.approx((200, 155), abs=1e-6)


def test_positions_from_another_map_need_no_georeference(folder):
    (folder / "old.cfg").write_text("sat.png;400;310\n5;photos/none.jpg;12;34\n6;photos/img2.jpg;400;310\n")
    report = run(folder, satellite=folder / "sat.png", positions=folder / "old.cfg")
    assert report.count(FileState.PLACED) == 2
    map_ = read_map(folder / "map.cfg")
    assert map_.georeference is None
    assert {e.photo: e.position for e in map_.experiences} == {
        "photos/none.jpg": MapPixel(12, 34),
        "photos/img2.jpg": MapPixel(400, 310),
    }
    (folder / "old.cfg").write_text("sat.png;500;310\n5;photos/none.jpg;12;34\n")
    with pytest.raises(UsageError, match="500 x 310"):
        run(folder, satellite=folder / "sat.png", positions=folder / "old.cfg", force=True)


def test_positions_in_pixels_outside_the_image(folder):
    (folder / "list.csv").write_text("name;x;y\nnone.jpg;-3;314\n")
    report = run(folder, satellite=folder / "sat.png", positions=folder / "list.csv")
    assert "5 px beyond the left and bottom edge" in [f.reason for f in report.files]


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"satellite": "sat.png"}, "--corners"),
        ({"source": GeoSource("geotiff")}, "blank"),
        ({"positions": "pixels.csv"}, "--satellite"),
        ({"satellite": "sat.png", "positions": "degrees.csv"}, "--corners"),
        ({"satellite": "sat.png", "source": GeoSource("corners", Path("c"), crs="EPSG:4326")}, "--crs"),
        ({"satellite": "sat.png", "source": GeoSource("geotiff", model="affine")}, "--model"),
        ({"cfg": "map.txt"}, ".cfg"),
        ({"photos": "nowhere"}, "folder not found"),
    ],
)
def test_requests_that_cannot_work(folder, options, part):
    (folder / "pixels.csv").write_text("name;x;y\nimg2.jpg;1;1\n")
    (folder / "degrees.csv").write_text("name;lat;lon\nimg2.jpg;1;1\n")
    options = {k: folder / v if isinstance(v, str) and k != "photos" else v for k, v in options.items()}
    with pytest.raises(UsageError) as caught:
        run(folder, **options)
    assert part in str(caught.value)


@pytest.mark.parametrize("kind", ["worldfile", "control-points"])
def test_other_sources_of_the_georeference(folder, kind):
    (folder / "sat.pgw").write_text(f"5e-6\n0\n0\n{-0.001 / 310}\n{14 + 2.5e-6}\n{50.001 - 0.0005 / 310}\n")
    (folder / "points.csv").write_text(
        "x;y;lat;lon\n0;0;50.001;14\n400;0;50.001;14.002\n400;310;50;14.002\n0;310;50;14\n"
    )
    file = folder / "points.csv" if kind == "control-points" else None
    report = run(folder, satellite=folder / "sat.png", source=GeoSource(kind, file))
    img2 = next(f.experience for f in report.files if f.name == "img2.jpg")
    assert img2.position == pytest.approx((200, 155), abs=1e-2)
    assert len(report.residuals_m) == (4 if kind == "control-points" else 0)


def test_links_out_of_the_folder_are_not_followed(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "secret.jpg"
    photo(outside, 50.0005, 14.001)
    try:
        (folder / "photos" / "link.jpg").symlink_to(outside)
        (folder / "photos" / "inner.jpg").symlink_to(folder / "photos" / "img2.jpg")
        (folder / "photos" / "loop.jpg").symlink_to(folder / "photos" / "loop.jpg")
    except OSError:
        pytest.skip("this system makes no links")
    found = states(on_image(folder))
    assert (found["link.jpg"], found["inner.jpg"], found["loop.jpg"]) == (
        FileState.UNREADABLE, FileState.PLACED, FileState.UNREADABLE,
    )  # fmt: skip


def test_limits_hold(folder):
    settings = Settings(photo=PhotoLimits(max_megapixels=1e-4))
    report = on_image(folder, settings=settings)
    assert report.count(FileState.UNREADABLE) == 7
    assert not report.written


def test_a_name_that_no_map_can_hold(folder):
    photo(folder / "photos" / "a;b.jpg", 50.0005, 14.001)
    file = next(f for f in on_image(folder).files if f.name == "a;b.jpg")
    assert file.state is FileState.UNREADABLE
    assert "rename" in file.reason


def test_progress_and_stopping(folder):
    class Counting(Progress):
        steps, total = 0, 0

        def size(self, total):
            self.total = total

        def advance(self, steps=1):
            self.steps += steps

        def cancelled(self):
            return self.steps == 3

    counting = Counting()
    with pytest.raises(Cancelled):
        on_image(folder, progress=counting)
    assert (counting.steps, counting.total) == (3, 8)
    assert not (folder / "map.cfg").exists()


def test_panoramas_of_a_folder_are_one_experience_each(tmp_path):
    pose = POSE.replace(b"%p", b"3").replace(b"%r", b"0")
    panorama(tmp_path / "photos" / "a.jpg", xmp=XMP.replace(b"/>", pose))
    panorama(tmp_path / "photos" / "b.jpg", xmp=b"")
    robot = np.full((90, 180), 255, np.uint8)
    robot[60:, :] = 0
    cv2.imwrite(str(tmp_path / "photos" / "mask.png"), robot)
    run(tmp_path)
    said, silent = read_map(tmp_path / "map.cfg").experiences
    assert (said.panorama, said.heading_deg, said.fov_deg) == (Panorama(tilt=Tilt(3.0)), 350.0, 360.0)
    assert silent.panorama is None
    around = PanoramaOptions(assume=True, mask=tmp_path / "photos" / "mask.png", highest_deg=45.0)
    run(tmp_path, panoramas=around, force=True)
    masked = (BlurBox(0.0, 0.0, 1.0, 0.25), BlurBox(0.0, 60 / 90, 1.0, 30 / 90))
    found = read_map(tmp_path / "map.cfg").experiences
    assert [e.photo for e in found] == ["photos/a.jpg", "photos/b.jpg"], "the mask is no photo"
    for one in found:
        assert one.panorama is not None
        assert np.allclose(one.panorama.masked, masked)
    assert [one.panorama.tilt for one in found] == [Tilt(3.0), Tilt()]


def test_files_beside_photos_and_stretched_contrast_are_said(tmp_path):
    photos = tmp_path / "photos"
    photo(photos / "a.jpg", 50.0, 14.0)
    photo(photos / "b.jpg")
    photo(photos / "c.jpg")
    Image.fromarray(np.linspace(500, 900, 1200).astype(np.uint16).reshape(30, 40)).save(photos / "d.png")
    (photos / "a.xmp").write_bytes(format_xmp(Geotag(LatLon(50.001, 14.001), heading_deg=90.0)))
    (photos / "b.jpg.json").write_text('{"geoData": {"latitude": 50.0005, "longitude": 14.0005}}')
    (photos / "d.png.xmp").write_bytes(format_xmp(Geotag(LatLon(50.0, 14.0))))
    report = from_photos.map_from_photos(
        photos,
        options=PlaceOptions(tmp_path / "map.cfg"),
        settings=Settings(),
        progress=Progress(),
    )
    files = {file.name: file for file in report.files}
    assert {name: file.position_from for name, file in files.items()} == {
        "a.jpg": "a.xmp", "a.xmp": None, "b.jpg": "b.jpg.json", "b.jpg.json": None, "c.jpg": None,
        "d.png": "d.png.xmp", "d.png.xmp": None,
    }  # fmt: skip
    assert files["a.jpg"].latlon == pytest.approx((50.001, 14.001))
    assert files["a.jpg"].experience.heading_deg == 90.0
    assert (files["a.xmp"].state, files["a.xmp"].reason) == (FileState.NOT_A_PHOTO, "it was read for a.jpg")
    assert "contrast was stretched" in files["d.png"].notes[-1]
