"""Panoramas as photos of a map: one experience each, searched by internal level views."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.tasks.localize.test_panorama_query import HIGH, PLACES, WIDE, opened, save, texture
from webapp.core.boxes import BlurBox
from webapp.core.geometry.equirectangular import cut_view, view_size
from webapp.core.mapmodel.panorama import Panorama, band, experience_of
from webapp.files.maps.folder import read_map, write_map
from webapp.files.photos.exif_write import CameraTags, write_view
from webapp.tasks.localize.spot import photo_headings


@pytest.fixture(scope="module")
def cfg(tmp_path_factory):
    """Three panoramas, and two photos of another place."""
    folder = tmp_path_factory.mktemp("whole")
    cv2.imwrite(str(folder / "plan.png"), np.full((200, 1000), 200, np.uint8))
    lines, records = ["plan.png;1000;200"], []
    for place in range(PLACES):
        name = f"photos/{place}.jpg"
        save(folder / name, texture(place))
        lines.append(f"{place};{name};{200 + 200 * place};100")
        records.append({"id": place, "photo": name, "heading_deg": 30.0, "panorama": {}})
    for number in (3, 4):
        view(folder / f"photos/{number}.jpg", place=7, turn=60.0 * number)
        lines.append(f"{number};photos/{number}.jpg;900;{40 * number}")
    (folder / "map.cfg").write_text("\n".join(lines) + "\n")
    extras = {"format": "experience-map", "version": 1, "experiences": records}
    (folder / "map.json").write_text(json.dumps(extras))
    return folder / "map.cfg"


def view(path, *, place, turn):
    """Write a perspective photo cut from the panorama of a place."""
    size = view_size(WIDE, 17)
    pixels, _ = cut_view(texture(place), size, turn_deg=turn)
    write_view(path, pixels, tags=CameraTags(None, size.focal_35mm))
    return path


@pytest.mark.parametrize("method", ["vote", "verified"])
def test_a_photo_finds_the_panorama_that_it_is_a_part_of(cfg, tmp_path, quick, method):
    pipeline = opened(cfg, quick, method=method)
    answer = pipeline.localize(view(tmp_path / "q.jpg", place=1, turn=150.0), top=5)
    first = answer.hypotheses[0]
    assert first.position == pytest.approx((400.0, 100.0), abs=15.0)
    assert first.experiences[0] == 1
    named = [id for h in answer.hypotheses for id in h.experiences]
    assert len(named) == len(set(named)), "a panorama is one experience, however many of its views match"
    total = sum(h.probability for h in answer.hypotheses) + answer.other_probability
    assert total + (answer.off_map_probability or 0.0) == pytest.approx(1.0)
    if method == "verified":
        assert first.heading_deg is None or first.heading_deg % 360.0 == pytest.approx(180.0, abs=5.0)


def test_matches_are_where_the_panorama_shows_the_same(cfg, tmp_path, quick):
    pipeline = opened(cfg, quick)
    one, *_ = pipeline.localize(view(tmp_path / "q.jpg", place=1, turn=150.0), top=1).evidence
    assert one.experience == 1 and one.inlier.sum() > 10
    middle = np.median(one.photo_xy[one.inlier], axis=0)
    assert middle[0] / WIDE * 360.0 - 180.0 == pytest.approx(150.0, abs=30.0)
    assert middle[1] == pytest.approx(HIGH / 2, abs=HIGH / 6)


def test_a_hidden_panorama_is_not_found(cfg, tmp_path, quick):
    pipeline = opened(cfg, quick)
    query = view(tmp_path / "q.jpg", place=1, turn=150.0)
    answer = pipeline.localize(query, top=5, hide=frozenset({1}))
    assert 1 not in {id for h in answer.hypotheses for id in h.experiences}


def test_a_panorama_finds_a_panorama(cfg, tmp_path, quick):
    query = save(tmp_path / "query.jpg", np.roll(texture(2), WIDE // 4, axis=1))
    first, *further = opened(cfg, quick).localize(query, top=5).hypotheses
    assert first.experiences[0] == 2
    assert all(2 not in h.experiences for h in further)


def test_the_index_has_six_views_of_each_and_the_map_one_experience(cfg, quick):
    pipeline = opened(cfg, quick)
    assert len(pipeline.map.experiences) == PLACES + 2
    ids = pipeline.opened.indexed.ids.tolist()
    assert [experience_of(id) for id in ids] == [n for n in range(PLACES) for _ in range(6)] + [3, 4]
    assert len(set(ids)) == len(ids)
    assert pipeline.opened.not_indexed == 0
    assert pipeline.map_kind == "metric", "views at one spot are no area"
    assert not set(photo_headings(pipeline)) & set(range(PLACES)), "a panorama looks everywhere"


def test_nothing_is_recognised_in_what_is_masked(cfg, quick):
    the_map = read_map(cfg)
    before = opened(cfg, quick).opened
    robot = BlurBox(0.0, 0.5, 1.0, 0.5)
    first = replace(the_map.experiences[0], panorama=Panorama((robot,)))
    write_map(cfg, replace(the_map, experiences=(first, *the_map.experiences[1:])))
    after = opened(cfg, quick).opened
    try:
        assert after.built is not None and after.built.extracted == 6, "only the views of that panorama"
        for number in range(6):
            features = after.indexed.features(number)
            assert (features.xy[:, 1] < features.photo_size[1] / 2 - 3).all()
            assert 0 < len(features) < len(before.indexed.features(number))
        assert before.contents[6:] == after.contents[6:]
    finally:
        write_map(cfg, the_map)


def test_a_band_is_two_boxes():
    above, below = band(lowest_deg=40.0, highest_deg=60.0)
    assert above == (0.0, 0.0, 1.0, pytest.approx(30.0 / 180.0))
    assert below == (0.0, pytest.approx(130.0 / 180.0), 1.0, pytest.approx(50.0 / 180.0))
    assert band() == ()
