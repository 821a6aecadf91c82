"""Photos of one spot with hints: which matches the answer shows."""

from types import SimpleNamespace

import numpy as np
import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Evidence, FieldOfView, Hypothesis, MatchStatistics
from webapp.core.hypotheses.priors import CirclePrior, fit_path_prior
from webapp.tasks.localize import spot
from webapp.tasks.localize.spot import Hints

PATHS = fit_path_prior(np.column_stack([np.arange(0.0, 2000.0, 10.0), np.zeros(200)]), place_radius_px=20.0)
COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)


def about(*places, pixel):
    """Make the answer to a photo: (photo of the map, probability), and a pixel of its matches."""
    hypotheses = tuple(
        Hypothesis(rank, "position", MapPixel(10.0 * id, 0.0), p, 10.0, 0.0, (id,), 30, 40)
        for rank, (id, p) in enumerate(places, 1)
    )
    at = np.full((1, 2), pixel, np.float32)
    evidence = tuple(Evidence(id, at, at, np.ones(1, bool)) for id, _ in places)
    off = 1.0 - sum(p for _, p in places)
    return Answer(hypotheses, off, 0.0, None, COUNTS, evidence, fov=FieldOfView(pixel, "exif"))


@pytest.fixture
def localizer():
    opened = SimpleNamespace(indexed=SimpleNamespace(paths=PATHS))
    return SimpleNamespace(looks=("sift",), opened=opened, limit_accuracy=lambda answer: answer)


@pytest.mark.parametrize(("circle", "best"), [(None, 0), (CirclePrior(900.0, 0.0, 30.0), 1)])
def test_the_matches_are_those_of_the_photo_that_is_named(localizer, circle, best):
    answers = [about((10, 0.6), pixel=50.0), about((90, 0.4), pixel=70.0)]
    joined, named = spot.combine(localizer, answers, hints=Hints(near=circle), top=1)
    assert named == best
    assert joined.hypotheses[0].experiences[0] == joined.evidence[0].experience == (10, 90)[best]
    assert joined.evidence[0].query_xy[0, 0] == (50.0, 70.0)[best]
    assert joined.fov == answers[best].fov
