"""Points of landmarks on disk, and as PLY."""

import numpy as np
import pytest

from webapp.files.landmarks.cloud import (
    MapPoints,
    as_ply,
    read_colours,
    read_points,
    write_colours,
    write_points,
)

POINTS = MapPoints(
    "abc",
    np.array([[1.5, -2.0, 3.25], [1e4, 0.0, -7.5]], np.float32),
    np.array([[255, 0, 7], [1, 2, 3]], np.uint8),
    np.array([2, 9], np.uint8),
    {"frame": "metres east, north and up", "unit": "m"},
)


def test_points_come_back_as_they_were(tmp_path):
    path = tmp_path / "points.arrays"
    assert read_points(path) is None
    write_points(path, POINTS)
    found = read_points(path)
    assert (found.key, found.about) == ("abc", POINTS.about)
    for name in ("xyz", "rgb", "times_seen"):
        np.testing.assert_array_equal(getattr(found, name), getattr(POINTS, name))
    path.write_bytes(path.read_bytes()[:-20])
    assert read_points(path) is None


def test_colours_are_those_of_their_cloud_only(tmp_path):
    path = tmp_path / "colours.arrays"
    write_colours(path, POINTS.rgb, key="one")
    np.testing.assert_array_equal(read_colours(path, key="one"), POINTS.rgb)
    assert read_colours(path, key="another") is None


def test_other_programs_read_the_ply(tmp_path):
    data = as_ply(POINTS)
    head, _, rows = data.partition(b"end_header\n")
    assert head.decode().splitlines()[:4] == [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres east, north and up",
        "element vertex 2",
    ]
    assert len(rows) == 2 * 15
    pycolmap = pytest.importorskip("pycolmap")
    (tmp_path / "points.ply").write_bytes(data)
    model = pycolmap.Reconstruction()
    model.import_PLY(tmp_path / "points.ply")
    found = {tuple(point.xyz): tuple(point.color) for point in model.points3D.values()}
    assert found == {(1.5, -2.0, 3.25): (255, 0, 7), (1e4, 0.0, -7.5): (1, 2, 3)}
