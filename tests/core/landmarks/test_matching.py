import numpy as np
import pytest

from webapp.core.landmarks.matching import Views, choose_pairs, match_mutually


def test_descriptors_match_where_they_are_each_others_clearly_nearest(rng):
    first = rng.integers(0, 256, (40, 16), dtype=np.uint8)
    order = rng.permutation(40)
    second = np.concatenate([first[order], rng.integers(0, 256, (10, 16), dtype=np.uint8)])
    matches = match_mutually(first, second)
    assert sorted(matches[:, 0].tolist()) == list(range(40))
    assert (order[matches[:, 1]] == matches[:, 0]).all()


def test_what_is_there_twice_matches_nothing(rng):
    first = rng.integers(0, 256, (5, 16), dtype=np.uint8)
    second = np.concatenate([first, first[:2]])
    assert sorted(match_mutually(first, second)[:, 0].tolist()) == [2, 3, 4]


def test_a_photo_without_texture_matches_nothing(rng):
    some = rng.integers(0, 256, (5, 16), dtype=np.uint8)
    assert match_mutually(some, some[:0]).shape == (0, 2)


def test_neighbours_in_time_and_on_the_map_and_photos_that_show_the_same_are_compared(rng):
    scene = rng.integers(0, 256, (60, 128), dtype=np.uint8)
    descriptors = [rng.integers(0, 256, (60, 128), dtype=np.uint8) for _ in range(30)]
    descriptors[2] = descriptors[25] = scene
    at = np.full(30, complex(np.nan, np.nan))
    at[[4, 20]] = [10 + 10j, 11 + 10j]
    pairs = {tuple(pair) for pair in choose_pairs(descriptors, at=at).tolist()}
    assert {(0, 1), (0, 6), (4, 20), (2, 25)} <= pairs
    assert all(one < other for one, other in pairs)
    descriptors[1] = scene[:0]
    assert not any(1 in pair for pair in choose_pairs(descriptors, at=at).tolist())


@pytest.mark.parametrize("turned", [0, 1, 3, 5])
def test_panoramas_are_compared_at_the_turn_at_which_they_match(rng, turned):
    scene = rng.integers(0, 256, (6, 40, 128), dtype=np.uint8)
    other = np.clip(np.roll(scene, turned, axis=0).astype(int) + rng.integers(-3, 4, scene.shape), 0, 255)
    elsewhere = rng.integers(0, 256, (6, 40, 128), dtype=np.uint8)
    views = Views(np.repeat([0, 1, 2], 6), np.tile(np.arange(0, 360, 60), 3))
    descriptors = [*scene, *other.astype(np.uint8), *elsewhere]
    pairs = [*views.between(0, 1, descriptors=descriptors)]
    assert pairs == [(view, 6 + (view + turned) % 6) for view in range(6)]
    nothing = [one[:0] for one in descriptors]
    assert [*views.between(0, 2, descriptors=nothing)] == [(n, 12 + n) for n in range(6)]
    at = np.full(18, complex(np.nan, np.nan))
    assert set(pairs) <= {tuple(pair) for pair in choose_pairs(descriptors, at=at, views=views).tolist()}


def test_a_photo_is_compared_with_all_views_of_a_panorama(rng):
    descriptors = [rng.integers(0, 256, (9, 128), dtype=np.uint8) for _ in range(7)]
    views = Views(np.array([0, *[1] * 6]), np.array([-1, *range(0, 360, 60)]))
    assert [*views.between(0, 1, descriptors=descriptors)] == [(0, n) for n in range(1, 7)]


def test_one_photo_has_none_to_be_compared_with(rng):
    one = rng.integers(0, 256, (60, 128), dtype=np.uint8)
    for photos in ([], [one], [one[:0], one[:0]]):
        assert choose_pairs(photos, at=np.full(len(photos), complex(np.nan, np.nan))).shape == (0, 2)
