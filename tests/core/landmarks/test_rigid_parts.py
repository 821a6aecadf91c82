import numpy as np

from webapp.core.landmarks.submodels import rigid_parts


def shared_by_neighbours(*counts):
    """Return points that each photo of a row shares with the next one."""
    shared = np.zeros((len(counts) + 1, len(counts) + 1), np.int32)
    for row, count in enumerate(counts):
        shared[row, row + 1] = shared[row + 1, row] = count
    return shared


def test_what_hangs_on_a_few_points_is_cut_off():
    parts = rigid_parts(shared_by_neighbours(90, 90, 90, 8, 70, 70))
    assert [part.tolist() for part in parts] == [[0, 1, 2, 3], [4, 5, 6]]


def test_parts_of_less_than_three_photos_are_left_out():
    assert [part.tolist() for part in rigid_parts(shared_by_neighbours(90, 3, 90, 90))] == [[2, 3, 4]]
    assert rigid_parts(np.zeros((4, 4), np.int32)) == []
