"""Groups of photos that see the same landmarks."""

import numpy as np

from webapp.core.landmarks.cloud import AlignedCloud, LandmarkCloud, observed_twice


def cloud_of(seen):
    """Return a cloud whose photo i, with id i + 10 on the map, sees the points `seen[i]`."""
    rows = np.concatenate([np.array(one, np.int32) for one in seen])
    count = int(rows.max()) + 1
    cloud = LandmarkCloud(
        tuple(str(n) for n in range(len(seen))),
        np.zeros((count, 3)),
        np.zeros(count, np.int32),
        np.cumsum([0, *map(len, seen)]),
        rows,
        np.zeros((len(rows), 2), np.float32),
        np.zeros((len(rows), 128), np.uint8),
        np.ones(len(seen)),
        np.zeros(len(seen)),
    )
    return AlignedCloud(cloud, "", np.arange(len(seen)) + 10, (), ())


def groups(aligned, photos, *, hidden=(), most=9):
    visible = ~np.isin(np.arange(len(aligned.map_photo)), hidden)
    return aligned.groups(np.array(photos), visible=visible, most=most)


def test_photos_that_see_the_same_are_a_group():
    aligned = cloud_of([range(20), range(5, 30), range(40, 60), range(40, 62), range(20, 45)])
    found = groups(aligned, [12, 10, 13, 11])
    assert [group.photos for group in found] == [[2, 3], [0, 1]]
    assert [group.photos for group in groups(aligned, [12, 10, 13, 11], most=1)] == [[2, 3]]
    first = found[0]
    assert set(aligned.cloud.seen_point[first.rows]) == set(range(40, 60))
    assert first.photo_of_row.tolist() == [2] * 20 + [3] * 20


def test_a_point_that_one_visible_photo_sees_does_not_count():
    aligned = cloud_of([range(20), range(20), range(15)])
    (group,) = groups(aligned, [10, 11], hidden=[1])
    assert group.photos == [0]
    assert set(aligned.cloud.seen_point[group.rows]) == set(range(15))
    assert groups(aligned, [11], hidden=[1]) == []


def test_photos_of_the_map_that_are_in_no_cloud_are_passed_over():
    assert groups(cloud_of([range(20), range(20)]), [3, 99]) == []


def test_an_observation_counts_once_a_photo_and_only_of_points_that_two_photos_see():
    point, photo = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 0, 1, 0, 0, 1])
    assert observed_twice(point, photo).tolist() == [True, False, True, False, False, False]
