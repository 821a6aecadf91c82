"""LightGlue and LighterGlue, with simple stand-ins and with the published weights."""

import cv2
import numpy as np
import pytest

from tests.standin_models import brightest, glue, lighter_glue
from webapp.core.features.extract import extract
from webapp.core.features.lightglue import LIGHTERGLUE, LIGHTGLUE, LightGlue
from webapp.core.features.table import choose
from webapp.core.features.types import Features, unit_as_bytes
from webapp.core.features.xfeat import XFeatNetwork
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.errors import InputError
from webapp.threads import in_threads

UNKNOWN = glue().replace(b"ArgMax", b"ArgMux")
"""A model with an unknown layer."""

WIDTHS = {"lighterglue": 64, "lightglue": 128}


def matcher(kind, **more):
    """Make one of the two matchers around a stand-in."""
    width = WIDTHS[kind]
    if kind == "lighterglue":
        return LightGlue(lighter_glue(width=width, **more), LIGHTERGLUE, file="lighterglue.onnx")
    return LightGlue(glue(width=width, **more), LIGHTGLUE, file="aliked_lightglue.onnx")


def photo(xy, size, *, rows=None, width=128):
    """Make features at pixels, with descriptors from rows of a table."""
    xy = np.asarray(xy, np.float32).reshape(-1, 2)
    units = np.random.default_rng(9).normal(size=(200, width)).astype(np.float32)
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    chosen = units[np.arange(len(xy)) if rows is None else rows]
    nothing = np.zeros(len(xy), np.float32)
    return Features(xy, nothing + 32, nothing, unit_as_bytes(chosen).reshape(-1, width), size)


def scattered(n, size, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (n, 2)) * size


@pytest.mark.parametrize("kind", WIDTHS)
@pytest.mark.parametrize("size", [(640, 480), (300, 800)])
def test_positions_are_in_halves_of_the_longer_side(kind, size):
    """The stand-in matches keypoints at the same position, with score 1 minus the distance."""
    width, find = WIDTHS[kind], matcher(kind)
    xy, order = scattered(50, size), np.random.default_rng(1).permutation(50)
    double = tuple(2 * side for side in size)
    found = find.match(photo(xy[order], size, width=width), photo(2 * xy, double, width=width))
    assert found.dtype == np.int64
    assert sorted(found[:, 0]) == list(range(50))
    assert (order[found[:, 0]] == found[:, 1]).all()
    half, (x, y) = max(size) / 2, np.array(size) / 2
    for step, matched in ((0.89, 1), (0.91, 0)):  # the minimum score is 0.1
        for along in ((step * half, 0), (0, step * half)):
            here, there = (photo([at], size, width=width) for at in ((x, y), np.add((x, y), along)))
            assert len(find.match(here, there)) == matched


@pytest.mark.parametrize("kind", WIDTHS)
def test_the_most_probable_come_first_and_each_row_once(kind):
    width = WIDTHS[kind]
    query = photo([(100, 100), (108, 100), (300, 100), (500, 410), (301, 100)], (640, 480), width=width)
    known = photo([(500, 400), (102, 100), (300, 100)], (640, 480), width=width)
    assert matcher(kind).match(query, known).tolist() == [[2, 2], [0, 1], [3, 0]]


@pytest.mark.parametrize("kind", WIDTHS)
def test_descriptors_reach_the_network_as_they_were(kind):
    width = WIDTHS[kind]
    query = photo(scattered(80, 400), (400, 400), width=width)
    rows = np.random.default_rng(2).permutation(80)
    found = matcher(kind, by="look").match(
        query, photo(scattered(80, 400, 3), (400, 400), rows=rows, width=width)
    )
    assert len(found) == 80
    assert (rows[found[:, 1]] == found[:, 0]).all()


@pytest.mark.parametrize("kind", WIDTHS)
@pytest.mark.parametrize(("here", "there"), [(0, 0), (0, 5), (5, 0)])
def test_without_keypoints_there_are_no_matches(kind, here, there):
    width, size = WIDTHS[kind], (64, 48)
    query, known = (photo(scattered(n, size), size, width=width) for n in (here, there))
    assert matcher(kind).match(query, known).shape == (0, 2)


@pytest.mark.parametrize("by", ["place", "look", "odd look"])
def test_any_numbers_of_keypoints_one_after_the_other(by):
    find = matcher("lightglue", by=by)
    for n, m in [(10, 10), (12, 10), (1, 1), (3, 40), (40, 3), (10, 10)]:
        found = find.match(photo(scattered(n, 400), (400, 400)), photo(scattered(m, 400), (400, 400)))
        assert [*map(tuple, sorted(found.tolist()))][: min(n, m)] == [(i, i) for i in range(min(n, m))]


def test_each_thread_gives_the_same():
    find = matcher("lightglue")
    pairs = [(photo(scattered(n, 400), (400, 400)), photo(scattered(m, 400, 7), (400, 400)))
             for n, m in [(50, 60), (30, 20), (60, 50)] * 4]  # fmt: skip
    alone = [find.match(*pair) for pair in pairs]
    for one, other in zip(alone, in_threads(lambda pair: find.match(*pair), pairs), strict=True):
        assert np.array_equal(one, other)


def test_another_file_is_one_clear_error():
    for wrong in (b"", b"no model at all" * 99, brightest("aliked"), glue(("matches", "scores")), UNKNOWN):
        with pytest.raises(InputError, match="not a LightGlue model that onnxruntime can run") as refused:
            LightGlue(wrong, LIGHTGLUE, file="aliked_lightglue.onnx")
        assert refused.value.where == "aliked_lightglue.onnx"
    narrow = matcher("lightglue", by="look")
    with pytest.raises(InputError, match="not a LightGlue model"):
        narrow.match(photo([(1, 1)], (9, 9)), photo([(1, 1)], (9, 9), width=64))


def inputs(query, known):
    """Return the network's inputs for two photos of 640 x 480."""
    places = [(p.xy - (320, 240)) / 320 for p in (query, known)]
    looks = [p.descriptors.astype(np.float32) - 128 for p in (query, known)]
    looks = [look / np.linalg.norm(look, axis=1, keepdims=True) for look in looks]
    return [blob.astype(np.float32) for blob in (*places, *looks)]


@pytest.fixture(scope="module")
def published(shared_models) -> LightGlue:
    """The network with real weights."""
    return LightGlue(
        (shared_models / "lighterglue_L3.onnx").read_bytes(), LIGHTERGLUE, file="lighterglue_L3.onnx"
    )


def test_the_published_network_takes_any_numbers_of_keypoints(published):
    size = (640, 480)
    for n, m in [(100, 100), (1, 1), (2, 90), (90, 2), (1000, 700), (100, 100)]:
        known = photo(scattered(m, size), size, rows=np.arange(m) % 200, width=64)
        query = known.subset(np.arange(n, dtype=np.int64) % m)
        found = published.match(query, known)
        assert found.shape[1] == 2
        assert len(found) <= min(n, m)
        for side in (0, 1):
            assert len(np.unique(found[:, side])) == len(found)
    assert (found[:, 0] == found[:, 1]).mean() > 0.9
    assert len(found) > 80


def test_matches_of_the_published_network_are_those_of_another_runtime(published, shared_models):
    """With one thread, OpenCV selects the same matches as the network."""
    data = np.frombuffer((shared_models / "lighterglue_L3.onnx").read_bytes(), np.uint8)
    net, size, threads = cv2.dnn.readNetFromONNX(data), (640, 480), cv2.getNumThreads()
    known = photo(scattered(300, size), size, rows=np.arange(300) % 200, width=64)
    query = photo(scattered(200, size, 4), size, rows=np.arange(200)[::-1], width=64)
    cv2.setNumThreads(1)
    try:
        for name, blob in zip(("kpts0", "kpts1", "desc0", "desc1"), inputs(query, known), strict=True):
            net.setInput(blob[None], name)
        pairs, scores = net.forward(["matches", "scores"])
    finally:
        cv2.setNumThreads(threads)
    picked = {tuple(p) for p in pairs.reshape(-1, 2)[scores.ravel() >= 0.1].tolist()}
    assert len(picked) > 20
    assert {tuple(p) for p in published.match(query, known).tolist()} == picked


def test_the_published_network_finds_more_than_nearest_neighbours(published, shared_models, shared_data):
    network = XFeatNetwork((shared_models / "xfeat_800x576.onnx").read_bytes())
    gray = cv2.imread(str(next((shared_data / "getty" / "photos").iterdir())), cv2.IMREAD_GRAYSCALE)
    height, width = gray.shape
    turn = np.vstack([cv2.getRotationMatrix2D((width / 2, height / 2), 10, 0.6), [0, 0, 1]])
    turn[2, :2] = 2e-4, 1e-4
    warped = cv2.warpPerspective(gray, turn, (width, height))
    choice = choose("verified", features="xfeat")
    a, b = (extract(g, choice, keypoints=1000, network=network) for g in (gray, warped))

    def right(pairs):
        moved = cv2.perspectiveTransform(a.xy[pairs[:, 0]][:, None].astype(np.float64), turn)[:, 0]
        return np.linalg.norm(moved - b.xy[pairs[:, 1]], axis=1) < 4.0

    there = BruteForce([b.descriptors], "l2").search(a.descriptors, 1).row[:, 0]
    back = BruteForce([a.descriptors], "l2").search(b.descriptors, 1).row[:, 0]
    mutual = np.flatnonzero(back[there] == np.arange(len(a)))
    nearest, glued = right(np.column_stack([mutual, there[mutual]])), right(published.match(a, b))
    assert glued.mean() > 0.8
    assert glued.mean() > nearest.mean()
    assert glued.sum() > nearest.sum()
    assert glued[: len(glued) // 2].mean() >= glued[len(glued) // 2 :].mean()
