"""When an adjustment is refused for its errors at positions that were left out."""

import numpy as np
import pytest

from webapp.core.landmarks.placing import KnownPositions
from webapp.tasks.landmarks.adjust import _refused

UNMEASURED = "too few positions can be left out to measure the error"
DISAGREE = "the photos do not agree with the positions"


@pytest.mark.parametrize(
    ("off_px", "before_px", "problem"),
    [
        ([9.0, 9.0, np.nan, np.nan], [10.0] * 4, UNMEASURED),
        ([14.0] * 4, [10.0] * 4, ""),
        ([16.0] * 4, [10.0] * 4, DISAGREE),
        ([16.0, 16.0, 16.0, np.nan], [10.0] * 4, DISAGREE),
        ([2.9] * 4, [0.1] * 4, ""),
        ([90.0] * 4, [10.0] * 2, ""),
    ],
    ids=["too few", "as good", "worse", "worse where measured", "as good as clicks", "nothing to compare"],
)
def test_an_adjustment_must_be_as_good_as_its_pieces(off_px, before_px, problem):
    known = KnownPositions(np.arange(4) * 100.0 + 0.0j, np.full(4, 2.0), np.zeros(4, np.bool_))
    left_out = np.column_stack([known.at.real, off_px, np.ones(4)])
    left_out[np.isnan(off_px)] = np.nan
    assert _refused(left_out, np.arange(4), dict(enumerate(before_px)), known=known) == problem
