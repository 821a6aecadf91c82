"""Photos are localized by the printed tags of a map, which needs no photo of its own."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.core.tags.drawn import FOCAL, WIDTH, corners_of, looking, photo_of, tag_at
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.verdict import verdict_of
from webapp.core.mapmodel.control_points import GroundControlPoint, Tag
from webapp.core.mapmodel.model import Map, SatelliteImage
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

METRIC = Georeference("EPSG:32633", (0.05, 0.0, 458000.0, 0.0, -0.05, 5549000.0, 0.0, 0.0, 1.0), "affine")
SCALE = 0.05
FOV = math.degrees(2.0 * math.atan(WIDTH / 2.0 / FOCAL))
CENTRE, ROTATION = np.array([10.0, 14.0, -1.5]), looking(math.radians(10.0), 0.05)
HEADINGS = {3: 190.0, 5: 180.0}


def point(number, x, y, *, name=None, heading=True, family="36h11", height=1.5):
    """Return a tag on a wall that faces about south; metres."""
    tag = Tag(family, number, 200.0, "wall", HEADINGS.get(number, 180.0) if heading else None)
    at = MapPixel(x / SCALE, y / SCALE)
    return GroundControlPoint(name or f"tag {number}", at, (), 0.01, height, tag)


DOOR, GATE = point(3, 10.0, 11.0), point(5, 10.8, 11.2)


@pytest.fixture
def ask(tmp_path):
    """A function that localizes a photo of some tags, as control points, on a map of others."""

    def run(on_map, in_photo, *, fov=FOV, **changes):
        cv2.imwrite(str(tmp_path / "plan.png"), np.full((600, 600), 200, np.uint8))
        the_map = Map(SatelliteImage("plan.png", 600, 600), (), georeference=METRIC)
        the_map = replace(the_map, control_points=tuple(sorted(on_map, key=lambda p: p.name)), **changes)
        cfg = tmp_path / "map.cfg"
        write_map(cfg, the_map)
        assert read_map(cfg).control_points == the_map.control_points
        query = tmp_path / "query.png"
        cv2.imwrite(str(query), photo_of([drawn(one) for one in in_photo]))
        pipeline = open_pipeline(cfg, OpenOptions(), settings=Settings(), progress=Progress(), fov_deg=fov)
        return pipeline.localize(query, top=5)

    return run


def drawn(one):
    at = np.array([one.position.x * SCALE, one.position.y * SCALE, -1.5])
    tag = tag_at(at, heading_deg=HEADINGS.get(one.tag.number, 180.0))
    return one.tag.family, one.tag.number, corners_of(tag, at, centre=CENTRE, rotation=ROTATION)


def off_m(hypothesis):
    x, y = hypothesis.position
    return math.dist((x * SCALE, y * SCALE), CENTRE[:2])


def test_one_tag_gives_position_heading_and_an_honest_radius(ask):
    answer = ask([DOOR, GATE], [DOOR])
    best = answer.hypotheses[0]
    assert verdict_of(answer) == "place"
    assert off_m(best) < 0.05
    assert 0.02 < best.radius_px * SCALE < 0.4
    assert best.heading_deg == pytest.approx(10.0, abs=1.0)
    assert best.camera.pitch_deg == pytest.approx(math.degrees(0.05), abs=1.0)
    assert best.camera.height_px * SCALE == pytest.approx(1.5, abs=0.05)
    assert answer.note == "by the tag 36h11 3"


def test_two_tags_give_the_whole_pose_without_their_headings(ask):
    answer = ask(
        [replace(DOOR, tag=replace(DOOR.tag, heading_deg=None)), point(5, 10.8, 11.2, heading=False)],
        [DOOR, GATE],
    )
    best = answer.hypotheses[0]
    assert off_m(best) < 0.05
    assert best.heading_deg == pytest.approx(10.0, abs=1.0)
    assert answer.note == "by the tags 36h11 3, 36h11 5"


def test_a_guessed_focal_length_is_in_the_radius(ask):
    sure, guessed = (ask([DOOR], [DOOR], fov=fov).hypotheses[0].radius_px * SCALE for fov in (FOV, None))
    assert guessed > 2.0 * sure
    assert off_m(ask([DOOR], [DOOR], fov=None).hypotheses[0]) < 2.0 * guessed


def test_one_tag_without_a_heading_says_how_far_away_it_is(ask):
    answer = ask([point(3, 10.0, 11.0, heading=False)], [DOOR])
    [only] = answer.hypotheses
    assert only.heading_deg is None
    assert only.radius_px * SCALE == pytest.approx(3.0, abs=0.2)
    assert "heading is not known" in answer.note


def test_a_tag_at_two_places_is_ambiguous_and_said_so(ask):
    other = point(3, 20.0, 20.0, name="copy")
    answer = ask([DOOR, other], [DOOR])
    assert "the map has the tag 36h11 3 at several places" in answer.note
    assert [h.probability for h in answer.hypotheses[:2]] == pytest.approx([0.495, 0.495], abs=0.02)
    assert min(off_m(h) for h in answer.hypotheses) < 0.05
    certain = ask([DOOR, other, GATE], [DOOR, GATE])
    assert "by the tag 36h11 5" in certain.note
    assert off_m(certain.hypotheses[0]) < 0.1


def test_tags_that_the_map_does_not_have_are_named(ask):
    unknown = ask([DOOR], [GATE])
    assert unknown.hypotheses == ()
    assert "the tag 36h11 5, which the map does not have" in unknown.no_pose.reason
    family = ask([DOOR], [point(3, 10.0, 11.0, family="6x6_250")])
    assert "the tag 6x6_250 3, which the map does not have" in family.no_pose.reason
    both = ask([DOOR], [DOOR, GATE])
    assert off_m(both.hypotheses[0]) < 0.05
    assert both.note == "the photo shows the tag 36h11 5, which the map does not have; by the tag 36h11 3"


def test_the_tag_of_a_check_point_localizes_no_photo(ask):
    note = "the photo shows the tag 36h11 5, at check points, by which no photo is localized"
    both = ask([DOOR, replace(GATE, is_check=True)], [DOOR, GATE])
    assert both.note == f"{note}; by the tag 36h11 3"
    assert ask([DOOR, replace(GATE, is_check=True)], [GATE]).no_pose.reason == note


def test_a_photo_without_tags_gives_no_place(ask):
    answer = ask([DOOR], [])
    assert (answer.hypotheses, answer.no_pose.reason) == ((), "no tag of the map is in sight")


def test_a_map_without_a_georeference_does_not_know_how_large_it_is(ask):
    answer = ask([DOOR], [DOOR], georeference=None)
    assert "on a map with a georeference" in answer.no_pose.reason


def test_a_tag_that_was_moved_is_named(ask):
    third = point(7, 9.2, 11.1)
    moved = replace(third, position=MapPixel(third.position.x, third.position.y + 20.0))
    answer = ask([DOOR, GATE, moved], [DOOR, GATE, third])
    assert "contradicted by the tag 36h11 7: was one moved?" in answer.note
    assert off_m(answer.hypotheses[0]) < 0.05
    assert answer.off_map_probability == pytest.approx(0.1)
