"""A panorama as a query: its views are localized together, with one answer."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.tasks.maps.test_cut_panoramas import LIMITS, POSE, XMP, tilted
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.equirectangular import panorama_pixels, view_size
from webapp.core.geometry.tilt import LEVEL, Tilt
from webapp.core.hypotheses.model import Answer, FieldOfView, Hypothesis, MatchStatistics
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.query_photo import PanoramaView, read_query
from webapp.tasks.localize.spot import ALL, Hints, combine
from webapp.tasks.maps.panoramas import CutOptions, cut_panoramas

WIDE, HIGH = 960, 480
PLACES = 3


def texture(seed):
    """Return a panorama full of corners, without a visible seam: random grey patches of two sizes."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (HIGH // 24, WIDE // 24), dtype=np.uint8)
    fine = random.integers(0, 256, (HIGH // 8, WIDE // 8), dtype=np.uint8)
    large = [cv2.resize(one, (WIDE, HIGH), interpolation=cv2.INTER_NEAREST) for one in (coarse, fine)]
    return cv2.merge([cv2.GaussianBlur(cv2.addWeighted(*[large[0], 0.7, large[1], 0.3, 0]), (5, 5), 0)] * 3)


def save(path, pixels, *, xmp=XMP):
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    if xmp:
        body = b"http://ns.adobe.com/xap/1.0/\x00" + xmp.replace(b"%s", b"0.0")
        data = data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


@pytest.fixture(scope="module")
def cfg(tmp_path_factory):
    """A map of three places, each with the six views of its panorama."""
    folder = tmp_path_factory.mktemp("panoramas")
    for place in range(PLACES):
        save(folder / "panoramas" / f"{place}.jpg", texture(place))
    cut = [
        *cut_panoramas(
            folder / "panoramas", folder / "photos", options=CutOptions(), limits=LIMITS, progress=Progress()
        )
    ]
    cv2.imwrite(str(folder / "plan.png"), np.full((200, 800), 200, np.uint8))
    lines = ["plan.png;800;200"]
    for place, one in enumerate(cut):
        for view in one.views:
            lines.append(f"{len(lines) - 1};photos/{view};{200 + 200 * place};100")
    (folder / "map.cfg").write_text("\n".join(lines) + "\n")
    return folder / "map.cfg"


def opened(cfg, settings, *, method="verified"):
    options = OpenOptions(method=method, features="sift", jobs=1)
    return open_pipeline(cfg, options, settings=settings, progress=Progress())


@pytest.fixture
def query(tmp_path):
    """The panorama of the second place, with the camera turned by 90 degrees."""
    return save(tmp_path / "query.jpg", np.roll(texture(1), WIDE // 4, axis=1))


@pytest.mark.parametrize("method", ["vote", "verified"])
def test_a_panorama_is_localized_by_all_its_views(cfg, query, quick, method):
    pipeline = opened(cfg, quick, method=method)
    answer = pipeline.localize(query, top=2)
    first = answer.hypotheses[0]
    assert np.hypot(first.position[0] - 400.0, first.position[1] - 100.0) < 20.0
    assert first.experiences[0] // 6 == 1
    assert answer.fov == (None if method == "vote" else FieldOfView(360.0, "exif"))
    total = sum(h.probability for h in answer.hypotheses) + answer.other_probability
    assert total + (answer.off_map_probability or 0.0) == pytest.approx(1.0)


def test_a_tilted_panorama_is_localized_by_level_views(cfg, tmp_path, quick):
    pose = XMP.replace(b"/>", POSE.replace(b"%p", b"25").replace(b"%r", b"-40"))
    pixels = tilted(texture(1), np.radians(25.0), np.radians(-40.0))
    query = save(tmp_path / "query.jpg", pixels, xmp=pose)
    answer = opened(cfg, quick, method="verified").localize(query, top=2)
    assert np.hypot(answer.hypotheses[0].position[0] - 400.0, answer.hypotheses[0].position[1] - 100.0) < 20.0
    one, *_ = answer.evidence
    size, tilt = view_size(WIDE, 17), Tilt(25.0, -40.0)
    turn = 60.0 * (one.experience % 6)
    xy = one.photo_xy[one.inlier].astype(float)
    there, _ = panorama_pixels(xy, size, panorama=(WIDE, HIGH), turn_deg=turn, tilt=tilt)
    off = one.query_xy[one.inlier] - there
    off[:, 0] = (off[:, 0] + WIDE / 2) % WIDE - WIDE / 2
    assert len(off) > 50
    assert np.median(np.hypot(*off.T)) < 2.0


@pytest.mark.parametrize("method", ["vote", "verified"])
def test_matches_are_in_pixels_of_the_panorama(cfg, query, quick, method):
    pipeline = opened(cfg, quick, method=method)
    one, *_ = pipeline.localize(query, top=1).evidence
    shown = one.inlier if method == "verified" else np.ones(len(one.query_xy), np.bool_)
    assert shown.sum() > 10
    turn = 60.0 * (one.experience % 6)
    size = view_size(WIDE, 17)
    there, _ = panorama_pixels(one.photo_xy[shown].astype(float), size, panorama=(WIDE, HIGH), turn_deg=turn)
    off = one.query_xy[shown] - there - [WIDE / 4, 0.0]
    off[:, 0] = (off[:, 0] + WIDE / 2) % WIDE - WIDE / 2
    assert np.median(np.hypot(*off.T)) < 2.0


def test_a_compass_is_not_compared_with_where_the_photos_look(cfg, query, quick):
    """The views match photos with any heading."""
    pipeline = opened(cfg, quick)
    answer = pipeline.observe(query, top=ALL)
    answer = replace(answer, hypotheses=tuple(replace(h, heading_deg=None) for h in answer.hypotheses))
    plain, _ = combine(pipeline, [answer], hints=Hints(), top=2)
    hinted, _ = combine(pipeline, [answer], hints=Hints(heading_deg=77.0), top=2)
    probabilities = [[h.probability for h in one.hypotheses] for one in (hinted, plain)]
    assert probabilities[0] == pytest.approx(probabilities[1])


def test_the_heading_is_that_of_the_middle():
    view = PanoramaView(view_size(WIDE, 17), (WIDE, HIGH), 300.0, LEVEL)
    seen = Hypothesis(1, "position", MapPixel(10.0, 20.0), 0.9, 5.0, -80.0, (1,), 30, 40)
    none = MatchStatistics(1, 0, 0, None, None, None, None)
    answer = Answer((seen,), 0.1, 0.0, None, none, fov=FieldOfView(91.0, "exif"))
    (first,) = view.to_panorama(answer).hypotheses
    assert first.heading_deg == pytest.approx(-20.0)  # -380 plus a full turn


def test_views_are_all_around_and_as_small_as_photos(query, quick):
    views = read_query(query, settings=quick, fov_deg=40.0, describe=None)
    assert [v.view.turn_deg for v in views] == [0.0, 60.0, 120.0, 180.0, 240.0, 300.0]
    assert all(v.fov.degrees == pytest.approx(91.0, abs=0.2) for v in views)
    assert all(max(v.gray.pixels.shape) <= quick.extract.max_side_px for v in views)


def test_what_does_not_say_that_it_is_a_panorama_is_a_photo(tmp_path, quick):
    wide = save(tmp_path / "wide.jpg", texture(5), xmp=b"")
    assert find_panorama(wide, read_facts(wide, limits=LIMITS), limits=LIMITS) is None
    (photo,) = read_query(wide, settings=quick, fov_deg=None, describe=None)
    assert photo.view is None
    narrow = save(tmp_path / "narrow.jpg", texture(5)[:, : WIDE // 2])
    assert find_panorama(narrow, read_facts(narrow, limits=LIMITS), limits=LIMITS) is None
