"""SURF: positions and sizes of blobs, and matches across a known transformation."""

import cv2
import numpy as np
import pytest

from webapp.core.features.extract import extract
from webapp.core.features.surf import detect_blobs
from webapp.core.features.table import choose
from webapp.core.retrieval.engines.bruteforce import BruteForce

CHOICE = choose("verified", features="surf")


@pytest.mark.parametrize("sigma", [2.5, 4.0, 7.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_blob_is_found_where_it_is_and_as_large_as_it_is(sigma, sign):
    y, x = np.mgrid[0:160, 0:200].astype(float)
    blob = 128 + sign * 100 * np.exp(-((x - 97.4) ** 2 + (y - 71.7) ** 2) / (2 * sigma**2))
    found = detect_blobs(cv2.integral(blob.round().astype(np.uint8)), 10, least=26.0)
    assert found.xy[0] == pytest.approx((97.4, 71.7), abs=0.1 * sigma)
    # the middle box of the filter is then as wide as the bright part of the blob, about 2 sigma
    assert found.scale[0] == pytest.approx(0.74 * sigma, rel=0.08)


def test_there_is_nothing_in_a_slope_or_along_an_edge():
    slope = np.tile(np.arange(0, 200, 1, np.uint8), (160, 1))
    edge = np.where(slope < 90, 40, 200).astype(np.uint8)
    assert len(detect_blobs(cv2.integral(slope), 10, least=0.26).xy) == 0
    assert len(detect_blobs(cv2.integral(edge), 10, least=0.26).xy) == 0


def test_a_photo_that_is_turned_by_a_right_angle_has_the_same_features_turned(textured_photo):
    gray = textured_photo(481, 361)  # so that every fourth pixel is also one of the rotated photo
    turned = np.ascontiguousarray(np.rot90(gray, -1))
    a, b = (extract(g, CHOICE, keypoints=200) for g in (gray, turned))
    expected = np.column_stack([360 - a.xy[:, 1], a.xy[:, 0]])
    apart = np.linalg.norm(expected[:, None] - b.xy[None], axis=2)
    same = apart.argmin(axis=1)
    assert np.mean(apart.min(axis=1) < 0.01) > 0.95
    assert np.allclose(b.size[same], a.size, rtol=1e-3)
    turn = np.remainder(b.angle[same] - a.angle - 90.0 + 180.0, 360.0) - 180.0
    assert np.mean(np.abs(turn) < 5.0) > 0.9


def test_most_ratio_test_matches_of_a_turned_and_smaller_photo_are_right(textured_photo):
    gray = textured_photo(680, 490)
    turn = np.vstack([cv2.getRotationMatrix2D((340, 245), 20, 0.75), [0, 0, 1]])
    warped = cv2.warpPerspective(gray, turn, (680, 490))
    a, b = (extract(g, CHOICE, keypoints=1000) for g in (gray, warped))
    found = BruteForce([b.descriptors], "l2").search(a.descriptors, 2)
    first, second = found.distance.T
    kept = first < 0.8 * second
    moved = cv2.perspectiveTransform(a.xy[kept][:, None].astype(np.float64), turn)[:, 0]
    right = np.linalg.norm(moved - b.xy[found.row[kept, 0]], axis=1) < 3.0
    assert right.sum() > 150
    assert right.mean() > 0.7


@pytest.fixture
def textured_photo():
    """Draw blobs, boxes and lines of many sizes and directions."""

    def make(width: int, height: int) -> np.ndarray:
        rng = np.random.default_rng(11)
        picture = np.zeros((height, width), np.float32)
        for size in (5, 10, 20, 40):
            coarse = rng.normal(size=(height // size + 2, width // size + 2)).astype(np.float32)
            picture += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) * size**0.5
        for _ in range(80):
            corners = cv2.boxPoints(
                ((rng.uniform(0, width), rng.uniform(0, height)), rng.uniform(8, 70, 2), rng.uniform(0, 90))
            )
            cv2.fillPoly(picture, [np.rint(corners).astype(np.int32)], float(rng.normal() * 12))
        return cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)

    return make
