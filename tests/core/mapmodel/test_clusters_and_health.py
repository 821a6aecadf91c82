"""Clusters of positions, and the weak places of a map."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.mapmodel.clusters import gather
from webapp.core.mapmodel.health import judge, widest_gap_deg
from webapp.core.mapmodel.model import Experience
from webapp.errors import UsageError

NOTHING = MatchStatistics(0, 0, 0, None, None, None, None)
POINTS = st.dictionaries(
    st.integers(0, 1000), st.builds(MapPixel, st.floats(0, 500), st.floats(0, 500)), max_size=40
)


def test_near_photos_gather_at_their_centre():
    at = {1: MapPixel(0, 0), 2: MapPixel(10, 0), 5: MapPixel(5, 3), 9: MapPixel(300, 300)}
    done = gather(at, radius_px=20)
    assert done[1] == done[2] == done[5] == pytest.approx((5, 1))
    assert done[9] == (300, 300)


@given(POINTS, st.floats(0.5, 200))
def test_clusters_are_small_and_inside(positions, radius):
    done = gather(positions, radius_px=radius)
    assert list(done) == sorted(positions)
    for id, at in done.items():
        assert math.dist(at, positions[id]) <= 2 * radius + 1e-6
        assert (
            min(p.x for p in positions.values()) - 1e-6 <= at.x <= max(p.x for p in positions.values()) + 1e-6
        )


@given(POINTS, st.floats(0.5, 200))
def test_the_order_of_photos_plays_no_part(positions, radius):
    again = dict(reversed(positions.items()))
    assert gather(positions, radius_px=radius) == gather(again, radius_px=radius)


def test_a_row_of_photos_does_not_become_one_place():
    row = {i: MapPixel(10.0 * i, 0) for i in range(100)}
    assert len(set(gather(row, radius_px=15).values())) > 25


@pytest.mark.parametrize("radius", [0, -1, math.nan, math.inf])
def test_what_is_no_radius(radius):
    with pytest.raises(UsageError):
        gather({1: MapPixel(0, 0)}, radius_px=radius)


@pytest.mark.parametrize(
    ("headings", "gap"), [([], 360), ([10], 360), ([0, 180], 180), ([350, 10], 340), ([0, 90, 180, 270], 90)]
)
def test_the_widest_gap(headings, gap):
    assert widest_gap_deg(headings) == pytest.approx(gap)


def experience(id, x, heading=None):
    return Experience(id, f"{id}.jpg", MapPixel(x, 0), heading_deg=heading)


def answer(*places):
    """Return an answer with places (x, probability, photo), the most probable first."""
    found = tuple(
        Hypothesis(i + 1, "photo", MapPixel(x, 0), p, None, None, (photo,), None, 10)
        for i, (x, p, photo) in enumerate(places)
    )
    return Answer(found, 0.1, 0.0, None if found else NoPose("nothing"), NOTHING)


MAP = [experience(0, 0, 0), experience(1, 5, 180), experience(2, 500, 10), experience(3, 900)]


@pytest.mark.parametrize(
    ("own", "answers", "state"),
    [
        (0, [answer((4, 0.9, 1)), answer((900, 0.2, 3))], "good"),
        (0, [answer((900, 0.9, 3), (4, 0.05, 1))], "confusable"),
        (0, [answer((4, 0.9, 1)), answer((900, 0.7, 3))], "confusable"),
        (0, [answer((900, 0.4, 3), (4, 0.3, 1))], "good"),
        (0, [answer((900, 0.4, 3))], "lonely"),
        (0, [answer((15, 0.9, 1))], "good"),
        (2, [answer()], "lonely"),
        (2, [answer((500, 0.9, 1))], "one-direction"),
        (3, [answer((900, 0.9, 1))], "good"),
    ],
)
def test_states(own, answers, state):
    (judged,) = judge(MAP, {own: answers}, place_radius_px=10)
    assert (judged.id, judged.state) == (own, state)
    if state == "confusable":
        assert judged.taken_for == 3 and judged.probability >= 0.5
