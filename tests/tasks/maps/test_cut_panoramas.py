"""Panoramas with known pixels are cut into views."""

from datetime import datetime

import cv2
import numpy as np
import piexif
import pytest

from webapp.core.geo.types import LatLon
from webapp.core.geometry.equirectangular import view_pixels, view_size
from webapp.errors import UsageError
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.maps.panoramas import CutOptions, cut_panoramas

LIMITS = PhotoLimits()
XMP = b"""<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description
 GPano:ProjectionType="equirectangular" GPano:PoseHeadingDegrees="%s"/></rdf:RDF></x:xmpmeta>"""


def panorama(path, *, heading=b"350.0", xmp=XMP, wide=720, high=360, pixels=None):
    """Write a panorama: blue is the angle from the middle, green the elevation, degrees."""
    columns, rows = np.meshgrid(np.arange(wide), np.arange(high))
    around = np.abs((columns + 0.5) / wide * 360.0 - 180.0)
    if pixels is None:
        pixels = np.stack([around, 180.0 * (1.0 - (rows + 0.5) / high), np.full_like(around, 60.0)], 2)
    _, data = cv2.imencode(".jpg", pixels.round().astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 100])
    data = data.tobytes()
    if xmp:
        body = b"http://ns.adobe.com/xap/1.0/\x00" + xmp.replace(b"%s", heading)
        data = data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:]
    tags = CameraTags(datetime(2026, 5, 1, 12, 30), 17, LatLon(50.0, 14.5), accuracy_m=2.5)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    piexif.insert(exif_bytes(tags), str(path))


def cut(folder, out, **options):
    return list(cut_panoramas(folder, out, options=CutOptions(**options), limits=LIMITS, progress=Progress()))


def test_views_look_where_they_say(tmp_path):
    panorama(tmp_path / "in" / "street" / "a.jpg")
    (done,) = cut(tmp_path / "in", tmp_path / "out", views=4)
    assert done.photo == "street/a.jpg"
    assert done.views == ("a_000.jpg", "a_090.jpg", "a_180.jpg", "a_270.jpg")
    for name, turn, blue in [("a_000.jpg", 0, 0), ("a_090.jpg", 90, 90), ("a_180.jpg", 180, 180)]:
        path = tmp_path / "out" / "street" / name
        pixels, facts = cv2.imread(str(path)), read_facts(path, limits=LIMITS)
        middle = pixels[pixels.shape[0] // 2, pixels.shape[1] // 2]
        np.testing.assert_allclose(middle, [blue, 90, 60], atol=3)
        assert facts.heading.deg == pytest.approx((350.0 + turn) % 360.0, abs=0.01)
        assert facts.heading.reference == "T"
        assert (facts.gps.lat, facts.gps.lon) == pytest.approx((50.0, 14.5), abs=1e-6)
        assert facts.gps.accuracy_m == pytest.approx(2.5)
        assert facts.taken_at.startswith("2026-05-01T12:30")
        # the edges of the view agree with its field of view
        edge = pixels[pixels.shape[0] // 2, 0, 0]
        expected = abs((turn - facts.fov_deg / 2.0 + 180.0) % 360.0 - 180.0)
        assert edge == pytest.approx(expected, abs=3)


def tilted(pixels, pitch, roll):
    """Return a panorama of the same place, taken by a camera of that pitch and roll (radians)."""
    high, wide = pixels.shape[:2]
    longitude, up = np.meshgrid(
        ((np.arange(wide) + 0.5) / wide - 0.5) * 2.0 * np.pi, (0.5 - (np.arange(high) + 0.5) / high) * np.pi
    )
    x, y, z = np.cos(up) * np.sin(longitude), -np.sin(up), np.cos(up) * np.cos(longitude)
    x, y = np.cos(roll) * x - np.sin(roll) * y, np.sin(roll) * x + np.cos(roll) * y
    y, z = np.cos(pitch) * y - np.sin(pitch) * z, np.sin(pitch) * y + np.cos(pitch) * z
    across = (np.arctan2(x, z) / (2.0 * np.pi) + 0.5) * wide - 0.5
    down = (0.5 - np.arctan2(-y, np.hypot(x, z)) / np.pi) * high - 0.5
    return cv2.remap(
        pixels,
        across.astype(np.float32),
        down.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )


POSE = b' GPano:PosePitchDegrees="%p" GPano:PoseRollDegrees="%r"/>'


@pytest.mark.parametrize(("pitch", "roll"), [(20.0, 0.0), (0.0, -35.0), (-15.0, 100.0)])
def test_views_of_a_tilted_panorama_are_level(tmp_path, pitch, roll):
    panorama(tmp_path / "level" / "a.jpg")
    pixels = tilted(cv2.imread(str(tmp_path / "level" / "a.jpg")), np.radians(pitch), np.radians(roll))
    pose = POSE.replace(b"%p", str(pitch).encode()).replace(b"%r", str(roll).encode())
    panorama(tmp_path / "tilted" / "a.jpg", xmp=XMP.replace(b"/>", pose), pixels=pixels)
    both = []
    for name in ("level", "tilted"):
        (done,) = cut(tmp_path / name, tmp_path / f"{name}-out", views=4)
        both.append([cv2.imread(str(tmp_path / f"{name}-out" / view)).astype(int) for view in done.views])
    for level, levelled in zip(*both, strict=True):
        assert np.percentile(np.abs(level - levelled), 99.0) <= 4


def test_a_tilt_that_cannot_be_is_ignored(tmp_path):
    for n, text in enumerate((b"nan", b"400", b"up")):
        pose = POSE.replace(b"%p", text).replace(b"%r", b"0")
        panorama(tmp_path / "in" / f"{n}.jpg", xmp=XMP.replace(b"/>", pose))
    panorama(tmp_path / "in" / "level.jpg")
    done = {one.photo: one.views for one in cut(tmp_path / "in", tmp_path / "out", views=1)}
    first, *others = (cv2.imread(str(tmp_path / "out" / view)) for (view,) in done.values())
    assert all((first == other).all() for other in others)


def test_the_seam_is_no_edge(tmp_path):
    panorama(tmp_path / "in" / "a.jpg")
    cut(tmp_path / "in", tmp_path / "out", views=2)
    row = cv2.imread(str(tmp_path / "out" / "a_180.jpg"))[100, :, 0].astype(int)
    assert np.abs(np.diff(row)).max() <= 4


def test_robot_and_sky_are_masked(tmp_path):
    panorama(tmp_path / "in" / "a.jpg")
    cut(tmp_path / "in", tmp_path / "out", views=1, lowest_deg=20.0, highest_deg=25.0)
    size = view_size(720, 17)
    _, _, elevation = view_pixels(size, panorama=(720, 360), turn_deg=0.0)
    middle = size.width // 2
    green = cv2.imread(str(tmp_path / "out" / "a_000.jpg"))[:, middle, 1].astype(int)
    above = elevation[:, middle]
    shown = (above > -17.0) & (above < 22.0)
    np.testing.assert_allclose(green[shown], 90.0 + above[shown], atol=4)
    masked = (above < -23.0) | (above > 28.0)
    assert masked.sum() > 20
    np.testing.assert_allclose(green[masked], 128, atol=4)


def test_what_is_no_panorama_is_told(tmp_path):
    folder = tmp_path / "in"
    panorama(folder / "a_plain.jpg", xmp=b"")
    panorama(folder / "b_narrow.jpg", wide=500)
    part = b' GPano:FullPanoWidthPixels="9000" GPano:CroppedAreaImageWidthPixels="720"/></rdf'
    cropped = XMP.replace(b"/></rdf", part)
    panorama(folder / "c_cropped.jpg", xmp=cropped)
    panorama(folder / "d_odd.jpg", heading=b"north")
    (folder / "e_broken.jpg").write_bytes(b"\xff\xd8nothing")
    done = cut(folder, tmp_path / "out", views=1)
    assert [(one.photo, len(one.views)) for one in done] == [
        ("a_plain.jpg", 0),
        ("b_narrow.jpg", 0),
        ("c_cropped.jpg", 0),
        ("d_odd.jpg", 1),
        ("e_broken.jpg", 0),
    ]
    assert done[0].problem == "it is not marked as a panorama"
    assert done[1].problem == done[2].problem == "it is not a full panorama, twice as wide as high"
    assert done[4].problem
    assert read_facts(tmp_path / "out" / "d_odd_000.jpg", limits=LIMITS).heading is None
    assert cut(folder, tmp_path / "again", views=1, assume=True)[0].views == ("a_plain_000.jpg",)


def test_views_do_not_go_among_the_panoramas(tmp_path):
    panorama(tmp_path / "in" / "a.jpg")
    with pytest.raises(UsageError, match="among the panoramas"):
        cut(tmp_path / "in", tmp_path / "in" / "views")


def test_a_folder_without_photos_is_told(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no photo"):
        cut(tmp_path / "empty", tmp_path / "out")


def test_photos_whose_views_would_be_the_same_files_are_not_both_cut(tmp_path):
    panorama(tmp_path / "in" / "a.jpeg")
    panorama(tmp_path / "in" / "a.jpg")
    panorama(tmp_path / "in" / "there" / "a.jpg")
    first, second, third = cut(tmp_path / "in", tmp_path / "out", views=1)
    assert (first.views, first.problem) == (("a_000.jpg",), "")
    assert second.views == () and "another photo" in second.problem
    assert third.views == ("a_000.jpg",)
