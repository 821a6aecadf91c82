"""The weight of the best-matching photo relative to the computed position is fitted on the map's photos."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.calibration import DEFAULT, EVIDENCE
from webapp.core.localize.places import PlaceCandidate
from webapp.core.retrieval.engines.types import DescriptorSearch
from webapp.core.retrieval.indexed import IndexedMap
from webapp.tasks.localize.calibrate import fit_trials
from webapp.tasks.localize.trials import Trial

RADIUS = 20.0
COMPUTED_SIGMA = 0.3 * RADIUS


@pytest.mark.parametrize(
    ("computed", "photo", "weight"),
    [
        pytest.param(
            2.0, 10.0, DEFAULT.photo_sigma, id="a walk whose photos stand half a place radius apart"
        ),
        pytest.param(0.5, 40.0, 3.0, id="positions that are computed exactly, photos far apart"),
        pytest.param(14.0, 1.0, 0.25, id="positions that are off, queries beside the photos"),
    ],
)
def test_the_best_photo_counts_as_much_as_it_helps(computed: float, photo: float, weight: float) -> None:
    fitted = fit_trials(_map(), [_trial(n, computed=computed, photo=photo) for n in range(20)])
    assert (fitted.photo_sigma, fitted.schematic) == (weight, False)


def _map() -> IndexedMap:
    position = np.column_stack([np.arange(20) * 200.0, np.zeros(20)])
    return IndexedMap(
        ids=np.arange(20),
        position=position,
        fov_deg=np.full(20, 60.0),
        segments=[],
        photo_of_entry=np.zeros(0, np.int64),
        search=cast(DescriptorSearch, None),  # nothing is looked for
        place_radius_px=RADIUS,
        kind="metric",
        kind_is_given=True,
    )


def _trial(number: int, *, computed: float, photo: float) -> Trial:
    """Make a trial from the errors of the computed position and of the best-matching photo."""
    truth = (number * 200.0, 0.0)
    place = PlaceCandidate(
        "position",
        MapPixel(truth[0], computed),
        None,
        COMPUTED_SIGMA,
        [],
        1.0,
        MapPixel(truth[0] + photo, 0.0),
    )
    return Trial(np.ones((1, EVIDENCE)), [place], truth, hidden="photo", strong=True, seconds=0.0)
