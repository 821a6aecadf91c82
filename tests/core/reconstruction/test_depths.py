"""Depths of what oriented photos see in common."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from photos_in_a_room import Scene, cameras

from webapp.core.reconstruction.depths import sightings_of
from webapp.core.reconstruction.types import Depths, Orientations, no_depths


@pytest.fixture(scope="module")
def room():
    scene = Scene(seed=4)
    held = cameras(scene, 12, seed=5)
    return scene, held, scene.pairs(held)


def oriented(held, trust=5.0):
    rotation = np.array([r for r, _ in held])
    return Orientations(rotation, np.zeros(len(held)), np.full(len(held), trust))


def positions(held):
    return np.array([p for _, p in held])


def seen_in(room, pairs=None, orientations=None):
    _, held, known = room
    return sightings_of(pairs or known, positions(held), orientations=orientations or oriented(held))


def found_in(room, **given):
    return seen_in(room, **given).averaged()


def truth_of(room, depths):
    scene, held, _ = room
    return np.array(
        [
            scene.inverse_depths(held[photo], [row])[0]
            for photo, row in zip(depths.photo, depths.row, strict=True)
        ]
    )


def test_depths_are_those_of_the_points(room):
    depths = found_in(room)
    off = depths.inverse / truth_of(room, depths) - 1.0
    assert len(depths.row) > 500
    assert np.median(np.abs(off)) < 0.03


def test_their_spread_is_about_how_far_they_are_off(room):
    depths = found_in(room)
    ratio = np.abs(depths.inverse - truth_of(room, depths)) / depths.spread
    assert 0.8 < (ratio < 1.0).mean() <= 1.0
    assert (depths.spread >= 0.05 * depths.inverse).all()


def test_each_keypoint_is_told_once_in_order(room):
    depths = found_in(room)
    keys = list(zip(depths.photo.tolist(), depths.row.tolist(), strict=True))
    assert keys == sorted(set(keys))


def test_wrong_matches_have_no_depth_or_an_uncertain_one(room):
    *_, pairs = room
    rng = np.random.default_rng(0)
    wrong = rng.random(len(pairs.row_first)) < 0.3
    shaken = pairs.ray_second.copy()
    shaken[wrong] = rng.uniform(-0.7, 0.7, (int(wrong.sum()), 2))
    depths = found_in(room, pairs=replace(pairs, ray_second=shaken))
    ratio = np.abs(depths.inverse - truth_of(room, depths)) / depths.spread
    assert (ratio < 3.0).mean() > 0.95


def test_photos_that_are_not_oriented_tell_none(room):
    _, held, _ = room
    known = oriented(held)
    depths = found_in(room, orientations=replace(known, trust=np.where(np.arange(12) == 3, 0.1, 5.0)))
    assert len(depths.row) and not (depths.photo == 3).any()
    assert not len(found_in(room, orientations=oriented(held, trust=0.0)).row)


def test_they_are_looked_up_by_photo_and_keypoint(room):
    depths = found_in(room)
    photo = int(depths.photo[200])
    there = depths.row[depths.photo == photo]
    absent = int(there.max()) + 1
    inverse, spread = depths.of(photo, np.array([there[1], absent, there[0]]))
    mine = np.flatnonzero(depths.photo == photo)
    assert inverse[[0, 2]].tolist() == depths.inverse[mine[[1, 0]]].tolist()
    assert spread[[0, 2]].tolist() == depths.spread[mine[[1, 0]]].tolist()
    assert np.isnan([inverse[1], spread[1]]).all()
    assert np.isnan(no_depths().of(photo, there)).all()
    assert depths.of(photo, np.zeros(0, np.int64))[0].shape == (0,)


def test_photos_can_get_other_numbers():
    depths = Depths(
        *(np.array(v, np.int32) for v in ([0, 0, 2, 3], [4, 9, 1, 7])),
        *(np.array(v, np.float32) for v in ([0.1, 0.2, 0.3, 0.4], [1, 2, 3, 4])),
    )
    again = depths.taken(np.array([5, -1, -1, 1]))
    assert again.photo.tolist() == [1, 5, 5]
    assert again.row.tolist() == [7, 4, 9]
    assert again.spread.tolist() == [4, 1, 2]


def test_without_some_photos_depths_are_as_if_these_had_never_been_there(room):
    _, held, pairs = room
    hidden = np.isin(np.arange(len(held)), [2, 5])
    left = np.flatnonzero(~(hidden[pairs.first] | hidden[pairs.second]))
    fewer = pairs.taken(left, first=pairs.first[left], second=pairs.second[left])
    without, never = seen_in(room).without(hidden), found_in(room, pairs=fewer)
    for name in ("photo", "row", "inverse", "spread"):
        assert (getattr(without, name) == getattr(never, name)).all()
    assert 0 < len(without.row) < len(found_in(room).row)
    assert not len(seen_in(room).without(np.ones(len(held), bool)).row)
