"""Covariances of cameras agree with those of the whole adjustment, and radii with actual errors."""

from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geometry import so3
from webapp.core.landmarks import uncertainty
from webapp.core.landmarks.absolute_pose import Lens, project
from webapp.core.landmarks.radii import PlacedPhotos, radius_by_covariance
from webapp.core.landmarks.submodels import Submodel
from webapp.core.landmarks.uncertainty import AdjustedCameras, position_covariances

pytest.importorskip("scipy")

LENS = Lens(640, 480, 500.0, 0.05)
KEYPOINT_PX = 0.7


def row_of_cameras(rng, *, frames):
    """Return cameras in a row that all see some points in front of them."""
    centre = np.column_stack(
        [np.linspace(0.0, 5.0, len(frames)), np.zeros(len(frames)), np.zeros(len(frames))]
    )
    rotation = so3.exp(rng.normal(0.0, 0.05, (len(frames), 3)))
    point = np.column_stack([rng.uniform(-4, 9, 40), rng.uniform(-3, 3, 40), rng.uniform(8.0, 16.0, 40)])
    seen = np.array([(c, p) for c in range(len(frames)) for p in range(40) if (c + p) % 3])
    lens = (np.full(len(frames), LENS.focal_px), np.full(len(frames), LENS.distortion))
    return AdjustedCameras(np.array(frames), centre, rotation, *lens, point, seen[:, 0], seen[:, 1])


def numeric(cameras, *, frames, prior_sigma):
    """Compute the same by inverting the full normal equations with numerical derivatives."""

    def residuals(unknown):
        move = unknown[: 6 * frames].reshape(frames, 6)
        points = cameras.point + unknown[6 * frames :].reshape(-1, 3)
        found = []
        for camera, point in zip(cameras.camera_row, cameras.point_row, strict=True):
            by = move[cameras.frame[camera]]
            xy = project(
                points[[point]],
                lens=LENS,
                rotation=cameras.rotation[camera] @ so3.exp(by[3:]),
                centre=cameras.centre[camera] + by[:3],
            )
            found.append(xy[0] / KEYPOINT_PX)
        return np.concatenate([*found, (move[:, :3] / prior_sigma).ravel()])

    size = 6 * frames + cameras.point.size
    steps = 1e-5 * np.eye(size)
    jacobian = np.stack([(residuals(step) - residuals(-step)) / 2e-5 for step in steps], 1)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    return np.array([inverse[6 * n : 6 * n + 2, 6 * n : 6 * n + 2] for n in range(frames)])


@pytest.mark.parametrize("frames", [[0, 1, 2, 3], [0, 0, 1, 2]], ids=["photos", "views of a panorama"])
def test_covariances_are_those_of_the_whole_adjustment(frames, rng):
    cameras, count = row_of_cameras(rng, frames=frames), max(frames) + 1
    prior = np.full((count, 3), np.inf)
    prior[0], prior[-1] = 0.2, 0.1
    found = position_covariances(cameras, keypoint_sigma_px=KEYPOINT_PX, prior_sigma=prior)
    assert found == pytest.approx(numeric(cameras, frames=count, prior_sigma=prior), rel=0.05, abs=1e-5)


def test_a_camera_that_nothing_holds_is_very_uncertain(rng):
    cameras = row_of_cameras(rng, frames=[0, 1, 2, 3])
    prior = np.full((4, 3), np.inf)
    prior[0] = prior[1] = 0.1
    seen = cameras.camera_row != 3
    alone = AdjustedCameras(
        cameras.frame, cameras.centre, cameras.rotation, cameras.focal_px, cameras.distortion, cameras.point,
        np.append(cameras.camera_row[seen], 3), np.append(cameras.point_row[seen], 0),
    )  # fmt: skip
    found = np.trace(position_covariances(alone, keypoint_sigma_px=1.0, prior_sigma=prior), axis1=1, axis2=2)
    assert found[3] > 100.0 * found[:3].max()


def test_more_cameras_than_memory_allows_have_no_covariances(monkeypatch, rng):
    monkeypatch.setattr(uncertainty, "MOST_CAMERAS", 3)
    cameras = row_of_cameras(rng, frames=[0, 1, 2, 3])
    assert position_covariances(cameras, keypoint_sigma_px=1.0, prior_sigma=np.ones((4, 3))) is None


def noisy_submodel(rng, *, sigma):
    """Return a submodel on the map whose errors are five times those of its covariances."""
    truth = rng.uniform(0.0, 500.0, (len(sigma), 2))
    centre = np.column_stack([truth + 5.0 * sigma[:, None] * rng.normal(size=truth.shape), 0.0 * sigma])
    covariance = sigma[:, None, None] ** 2 * np.eye(2)
    return Submodel(
        np.arange(len(sigma)), centre, np.tile(np.eye(3), (len(sigma), 1, 1)), 0.0, covariance
    ), truth


def placed(row, at, *, sigma_px):
    """Return placed photos of a submodel."""
    return PlacedPhotos(row, at, np.full(len(row), sigma_px), np.zeros(len(row), np.bool_))


def test_radii_hold_two_thirds_and_grow_where_little_holds_a_photo(rng):
    sigma = np.where(np.arange(600) % 5, 1.0, 4.0)
    submodel, truth = noisy_submodel(rng, sigma=sigma)
    row = np.arange(0, 600, 9)
    known = placed(row, truth[row, 0] + 1j * truth[row, 1], sigma_px=0.01)
    radius = radius_by_covariance(submodel, known)
    off = np.linalg.norm(submodel.centre[:, :2] - truth, axis=1)
    assert np.mean(off <= radius) == pytest.approx(0.68, abs=0.08)
    assert radius[0] == pytest.approx(4.0 * radius[1])


def test_a_position_that_the_adjustment_had_says_less_than_its_residual(rng):
    """The adjustment pulls a photo to its position; without it, its residual would be larger."""
    submodel, _ = noisy_submodel(rng, sigma=np.full(9, 1.0))
    at = submodel.centre[:, 0] + 1j * submodel.centre[:, 1] + 2.0
    left_out = radius_by_covariance(submodel, placed(np.arange(9), at, sigma_px=0.01))
    used = radius_by_covariance(submodel, placed(np.arange(9), at, sigma_px=1.05))
    assert used[0] > 2.0 * left_out[0]


def test_errors_of_the_known_positions_are_not_taken_for_those_of_the_submodel(rng):
    submodel, truth = noisy_submodel(rng, sigma=np.full(200, 1.0))
    noisy = truth + rng.normal(0.0, 20.0, truth.shape)
    known = placed(np.arange(200), noisy[:, 0] + 1j * noisy[:, 1], sigma_px=20.0)
    assert 0.5 * 1.515 * 20.0 <= radius_by_covariance(submodel, known)[0] < 20.0


def test_derived_positions_do_not_measure_how_far_off_a_submodel_is(rng):
    submodel, truth = noisy_submodel(rng, sigma=np.full(60, 1.0))
    row = np.arange(60)
    at = np.where(
        row < 20, truth[:, 0] + 1j * truth[:, 1], submodel.centre[:, 0] + 1j * submodel.centre[:, 1]
    )
    sigma_px = np.where(row < 20, 0.01, 4.0)
    given = PlacedPhotos(row, at, sigma_px, row >= 20)
    alone = given.subset(row < 20)
    assert radius_by_covariance(submodel, given) == pytest.approx(radius_by_covariance(submodel, alone))


def test_two_placed_photos_measure_nothing(rng):
    submodel, truth = noisy_submodel(rng, sigma=np.full(9, 1.0))
    at = truth[:2, 0] + 1j * truth[:2, 1]
    assert radius_by_covariance(submodel, placed(np.arange(2), at, sigma_px=1.0)) is None


def test_positions_left_out_of_the_adjustment_measure_the_radius(rng):
    """A model that follows its positions wherever they are looks exact until some are left out."""
    submodel, truth = noisy_submodel(rng, sigma=np.full(40, 1.0))
    at = truth[:, 0] + 1j * truth[:, 1]
    there = at + 30.0 * np.exp(1j * np.arange(40))
    left_out = np.column_stack([there.real, there.imag, np.ones(40)])
    left_out[20:] = np.nan
    known = placed(np.arange(30), at[:30], sigma_px=0.01)
    radius = radius_by_covariance(replace(submodel, left_out=left_out), known)
    assert radius == pytest.approx(np.full(40, 30.0), rel=0.01)
    assert radius_by_covariance(submodel, known).max() < 20.0
    left_out[2:] = np.nan
    assert radius_by_covariance(replace(submodel, left_out=left_out), known) is None, "two measure nothing"
