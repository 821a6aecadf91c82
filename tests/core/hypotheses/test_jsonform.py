import json
import math
from dataclasses import replace

import pytest

from webapp.core.geo.floors import Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.jsonform import (
    AnswerSource,
    answer_from_json,
    answer_to_json,
    failure_to_json,
)
from webapp.core.hypotheses.model import Answer, FieldOfView, Hypothesis, MatchStatistics

KEYS = [
    "query", "method", "features", "fov_deg", "fov_source", "verdict", "sentence", "hypotheses",
    "other_probability", "off_map_probability", "statistics", "seconds", "map_revision", "map_kind",
    "place_radius_px", "looks",
]  # fmt: skip
HYPOTHESIS_KEYS = [
    "rank", "kind", "x_px", "y_px", "radius_px", "heading_deg", "lat", "lon", "radius_m", "probability",
    "experiences", "inliers", "matches",
]  # fmt: skip
STATISTICS_KEYS = [
    "keypoints", "matches", "matches_pruned", "distance_min", "distance_max", "distance_mean",
    "distance_total",
]  # fmt: skip
SECONDS_KEYS = ["read", "extract", "retrieve", "verify", "position", "total"]

GEOREFERENCE = Georeference("EPSG:4326", (1e-5, 0, 14.0, 0, -1e-5, 50.0, 0, 0, 1), "corners")
ANSWER = Answer(
    (Hypothesis(1, "position", MapPixel(100.5, 200.25), 0.7, 12.0, 33.0, (4, 2), 55, 120),),
    0.2,
    0.1,
    None,
    MatchStatistics(900, 800, 400, 0.1, 0.8, 0.5, 400.0),
    (),
    {"extract": 0.1, "total": 0.5},
)


def test_keys_are_those_of_the_interface() -> None:
    form = answer_to_json(ANSWER, query="q.jpg", source=AnswerSource("verified", "sift", GEOREFERENCE, 3))
    assert list(form) == KEYS
    assert list(form["hypotheses"][0]) == HYPOTHESIS_KEYS
    assert list(form["statistics"]) == STATISTICS_KEYS
    assert list(form["seconds"]) == SECONDS_KEYS
    assert form["seconds"]["read"] is None
    assert form["map_revision"] == 3
    json.dumps(form, allow_nan=False)


@pytest.mark.parametrize(
    ("kind", "probability", "verdict", "sentence"),
    [
        ("position", 0.7, "place", "At x 100, y 200."),
        ("area", 0.7, "place", "In the area at x 100, y 200."),
        ("photo", 0.7, "place", "Near the photo with id 4 at x 100, y 200."),
        ("position", 0.4, "perhaps_place", "Uncertain, perhaps at x 100, y 200."),
        ("area", 0.4, "perhaps_place", "Uncertain, perhaps in the area at x 100, y 200."),
        ("photo", 0.4, "perhaps_place", "Uncertain, perhaps near the photo with id 4 at x 100, y 200."),
        ("photo", 0.1, "perhaps_off_map", "Uncertain, perhaps not on this map."),
    ],
)
def test_an_answer_is_said_in_a_sentence(kind, probability, verdict, sentence) -> None:
    place = replace(ANSWER.hypotheses[0], kind=kind, probability=probability)
    answer = replace(ANSWER, hypotheses=(place,), other_probability=0.8 - probability)
    form = answer_to_json(answer, query="q.jpg", source=AnswerSource("verified", "sift", None, 3))
    assert (form["verdict"], form["sentence"]) == (verdict, sentence)


def test_georeferenced_hypothesis_is_in_degrees_and_metres() -> None:
    source = AnswerSource("verified", "sift", GEOREFERENCE, 0)
    form = answer_to_json(replace(ANSWER, fov=FieldOfView(60.0, "exif")), query="q.jpg", source=source)
    found = form["hypotheses"][0]
    assert found["lat"] == pytest.approx(49.9979975, abs=1e-9)
    assert found["lon"] == pytest.approx(14.001005, abs=1e-9)
    # A pixel is 1e-5 degree: 1.112 m to the north, 0.717 m to the east there.
    assert found["radius_m"] == pytest.approx(12 * math.sqrt(1.112 * 0.717), rel=2e-3)
    assert (form["fov_deg"], form["fov_source"]) == (60.0, "exif")


def test_plain_map_and_vote_leave_null_what_they_do_not_know() -> None:
    vote = Answer(
        (Hypothesis(1, "photo", MapPixel(1, 2), 1.0, None, None, (0,), None, 7),),
        None,
        0.0,
        None,
        MatchStatistics(7, 7, 7, 0.0, 0.0, 0.0, 0.0),
    )
    form = answer_to_json(vote, query="q.jpg", source=AnswerSource("vote", "orb", None, 0))
    found = form["hypotheses"][0]
    assert [found[k] for k in ("radius_px", "heading_deg", "lat", "lon", "radius_m", "inliers")] == [None] * 6
    assert form["off_map_probability"] is None
    assert form["fov_deg"] is None


def test_beyond_the_horizon_is_null_and_not_nan() -> None:
    tilted = Georeference("EPSG:4326", (1e-5, 0, 14.0, 0, -1e-5, 50.0, 0, -0.01, 1), "projective")
    form = answer_to_json(ANSWER, query="q.jpg", source=AnswerSource("verified", "sift", tilted, 0))
    assert form["hypotheses"][0]["lat"] is None
    assert form["hypotheses"][0]["radius_m"] is None


def test_no_pose_is_an_empty_list() -> None:
    nothing = Answer((), 1.0, 0.0, NoPose("no keypoint"), MatchStatistics(0, 0, 0, None, None, None, None))
    form = answer_to_json(nothing, query="q.jpg", source=AnswerSource("verified", "sift", None, 0))
    assert form["hypotheses"] == []
    assert form["off_map_probability"] == 1.0


def test_failed_photo() -> None:
    assert failure_to_json(query="q.jpg", error="not a photo") == {"query": "q.jpg", "error": "not a photo"}


def test_what_is_written_can_be_read_for_pictures() -> None:
    source = AnswerSource("verified", "sift", GEOREFERENCE, 0)
    form = json.loads(json.dumps(answer_to_json(ANSWER, query="q.jpg", source=source)))
    read = answer_from_json(form)
    assert (read.hypotheses, read.abstained) == (ANSWER.hypotheses, False)
    assert (read.off_map_probability, read.other_probability) == (0.2, 0.1)
    nothing = answer_from_json({"hypotheses": [], "off_map_probability": 1.0})
    assert nothing.abstained and nothing.no_pose is not None


def test_a_place_names_its_floor_on_a_map_that_has_floors():
    floors = (Floor(0, "Ground floor", 0.0), Floor(2, "1st floor", 1.0, 4.5))
    there = replace(ANSWER, hypotheses=tuple(replace(h, floor=2) for h in ANSWER.hypotheses))
    form = answer_to_json(
        there, query="q.jpg", source=AnswerSource("verified", "sift", None, 0, floors=floors)
    )
    first = form["hypotheses"][0]
    assert (first["floor"], first["floor_name"], first["floor_height_m"]) == (2, "1st floor", 4.5)
    assert answer_from_json(form).hypotheses[0].floor == 2
    without = answer_to_json(there, query="q.jpg", source=AnswerSource("verified", "sift", None, 0))
    assert not {"floor", "floor_name", "floor_height_m"} & without["hypotheses"][0].keys()
