"""Figures of the benchmark of a placed cloud, and its choice between answers."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")

from benchmarks import placed_cloud
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import CameraPose, Hypothesis
from webapp.files.localize.queries_csv import Query

pytestmark = pytest.mark.slow


def place(x, landmarks=None):
    camera = None if landmarks is None else CameraPose(0.0, 0.0, 0.0, np.eye(6), landmarks)
    return Hypothesis(1, "position", MapPixel(x, 0.0), 0.9, 5.0, None, (1,), 30, 30, camera)


QUERY = Query("q.jpg", Path("q.jpg"), MapPixel(0.0, 0.0))


@pytest.mark.parametrize(
    ("verified", "landmarks", "chosen"),
    [
        (place(20.0), place(12.0, 40), "landmarks"),
        (place(20.0), place(12.0, 39), "verified"),  # too few inliers
        (place(20.0), place(31.0, 90), "verified"),  # another place
        (place(20.0), None, "verified"),
        (None, place(12.0, 90), "verified"),
    ],
)
def test_landmarks_answer_where_enough_agree_in_the_same_place(verified, landmarks, chosen):
    pair = placed_cloud.Pair(QUERY, verified, landmarks)
    assert pair.combined(agreeing=40, place_radius_px=10.0) is getattr(pair, chosen)


def test_shares_are_of_all_queries():
    far = dataclasses.replace(QUERY, truth=MapPixel(100.0, 0.0))
    found = placed_cloud.shares([(QUERY, place(9.0)), (QUERY, place(21.0)), (far, None)], unit=10.0)
    assert found["within_1"] == pytest.approx(1 / 3, abs=1e-3)
    assert found["within_5"] == pytest.approx(2 / 3, abs=1e-3)
    assert found["unanswered"] == pytest.approx(1 / 3, abs=1e-3)
