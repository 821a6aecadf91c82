"""Adjustments without some of the known positions, and what they say of the one with all."""

from pathlib import Path

import numpy as np

from webapp.core.landmarks.placing import KnownPositions
from webapp.files.landmarks.colmap import Model
from webapp.progress import Progress
from webapp.tasks.landmarks import adjust
from webapp.tasks.landmarks.adjust import _Joined, _left_out, _refused

AT = np.array([0.0, 100.0, 200.0, 300.0, 400.0]) + 0.0j


def known(at=AT):
    return KnownPositions(at, np.ones(len(at)), np.zeros(len(at), np.bool_))


class Joining:
    """Finds each photo where it is, without covariances: as of a model with too many photos for them."""

    def __init__(self, photo):
        self.pictures = photo
        self.centre = np.column_stack([AT[photo].real, AT[photo].imag, 0.0 * photo])

    def join(self, known, *, out, progress, least):
        rotation = np.tile(np.eye(3), (len(self.pictures), 1, 1))
        shared, frame = np.zeros((0, 0), np.int32), np.arange(len(self.pictures))
        model = Model([str(n) for n in frame], self.centre, rotation, shared, frame)
        return _Joined(model, frame, [0])


def test_a_model_with_too_many_photos_for_covariances_is_measured_all_the_same():
    numbers = np.arange(5)
    left_out = _left_out(Joining(numbers), known(), numbers, out=Path("adjusted"), progress=Progress())
    np.testing.assert_array_equal(left_out, np.column_stack([AT.real, AT.imag, np.ones(5)]))
    assert _refused(left_out, numbers, dict.fromkeys(range(5), 1.0), known=known()) == ""


def test_a_panorama_counts_once():
    numbers = np.array([0] * 6 + [1, 2, 3, 4])
    left_out = np.zeros((10, 3))
    left_out[6:] = np.nan
    assert _refused(left_out, numbers, {}, known=known()) == adjust._UNMEASURED
    left_out[6:] = np.column_stack([AT[1:].real + 50.0, AT[1:].imag, np.ones(4)])
    before = dict.fromkeys(range(5), 1.0)
    assert _refused(left_out, numbers, before, known=known()) == adjust._DISAGREE
