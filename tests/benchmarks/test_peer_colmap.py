"""The benchmark's own steps around COLMAP: retrieval vectors, and alignment of the model to the map."""

import numpy as np
import pytest

pytest.importorskip("pycolmap")

from benchmarks import peer_colmap

pytestmark = pytest.mark.slow


def model(position, centre):
    names = [f"{n}.jpg" for n in range(len(centre))]
    return peer_colmap.Model(None, np.eye(3)[:2], names, centre, position)


def test_a_point_of_the_model_comes_to_the_map_by_the_photos_around_it():
    rng = np.random.default_rng(0)
    centre = rng.uniform(-1.0, 1.0, (40, 2))
    turn = 25.0 * np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    position = centre @ turn.T + [300.0, 200.0]
    position[::10] += 500.0  # placed wrongly
    at = peer_colmap._to_map(model(position, centre), np.array([0.2, -0.1]))
    assert at == pytest.approx(turn @ [0.2, -0.1] + [300.0, 200.0], abs=0.5)


def test_photos_of_the_same_words_are_retrieved_first():
    rng = np.random.default_rng(1)
    words = rng.uniform(0.0, 1.0, (peer_colmap.WORDS, 128)).astype(np.float32)
    scenes = [rng.uniform(0.0, 1.0, (200, 128)).astype(np.float32) for _ in range(4)]
    vectors = np.array([peer_colmap._vlad(rows, words) for rows in scenes])
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(1.0, abs=1e-5)
    again = peer_colmap._vlad(scenes[2][::2], words)
    assert peer_colmap._nearest(again, vectors, 2)[0] == 2
    assert not peer_colmap._vlad(scenes[0][:0], words).any()


@pytest.mark.parametrize(("limit", "chosen"), [(0, [0, 1, 2, 3, 4]), (2, [0, 2]), (9, [0, 1, 2, 3, 4])])
def test_queries_are_spread(limit, chosen):
    assert peer_colmap._spread(5, limit) == chosen
