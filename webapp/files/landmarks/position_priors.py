"""Known positions of cameras as priors of pycolmap's bundle adjustment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.control_points import (
    CLICK_RAD,
    KnownPoint,
    NotTriangulated,
    sigma_by_points,
    triangulate,
)
from webapp.core.landmarks.heights import CameraHeights
from webapp.core.landmarks.submodels import Submodel, of_photos, view_rotation
from webapp.files.landmarks.lens_priors import add_lens_priors, free_id, known_focal_lengths

Array = NDArray[np.float64]

_ABOVE = 1e5
"""Height of the virtual camera above a control point, in standard deviations of the point's position."""

_ANYWHERE = 1e9
"""Standard deviation of an unknown coordinate, map pixels."""

_CORNERS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))


@dataclass(frozen=True, slots=True, eq=False)
class PicturePositions:
    """Known positions of pictures on a map; the world frame is the map's, see `AdjustJob`."""

    pictures: tuple[str, ...]  # The p pictures that take part
    photo: NDArray[np.int64]  # (p,) int64. Numbers of their photos; the views of a panorama share one.
    # (p,) int64. Clockwise rotation of each from the middle of its panorama; 0 for an ordinary photo.
    turn_deg: NDArray[np.int64]
    known: tuple[str, ...]  # The k pictures whose positions are known
    at: Array  # (k, 2) float64
    sigma_px: Array  # (k,) float64. Standard deviation along each axis.
    height_sigma_px: float  # Standard deviation of the heights of the cameras, where they are unknown
    # Control points that the photos show; they refer to the photos' numbers.
    points: tuple[KnownPoint, ...]
    heights: CameraHeights  # Of the pictures

    @property
    def height_of(self) -> Mapping[str, float]:
        """The known heights, by picture, map pixels above the mean of the flight."""
        known = np.flatnonzero(self.heights.flight >= 0).tolist()
        return {self.pictures[row]: float(self.heights.height_px[row]) for row in known}

    def everything(self) -> Array:
        """List all known positions, of pictures and control points, (k + points, 2)."""
        points = np.array([[point.at.real, point.at.imag] for point in self.points])
        return np.concatenate([self.at, points.reshape(-1, 2)])


class _Photos(NamedTuple):
    """The photos of a model: as a submodel, and the reference images of their frames by photo number."""

    submodel: Submodel
    image: Mapping[int, Any]


class PositionPriors:
    """Known positions for the adjustment of a model.

    Placed photos get pycolmap's position priors. A control point becomes a 3D point that the map's image also
    observes, by a virtual camera: fixed, far above the point, looking straight down.

    Args:
        cache: Gets four beacons: images without keypoints, for the corners of a tetrahedron. Before the
            adjustment, pycolmap aligns the model with the priors by a similarity, and refuses priors that are
            all at the same height. Beacons are off that plane; as their priors equal their poses, they keep
            the model in place.
    """

    def __init__(self, colmap: Any, *, cache: Any, positions: PicturePositions) -> None:
        self._colmap, self._positions = colmap, positions
        placed = zip(positions.known, positions.at, positions.sigma_px, strict=True)
        self.placed: Mapping[str, tuple[Array, float]] = {name: (at, sigma) for name, at, sigma in placed}
        self._row = {name: row for row, name in enumerate(positions.pictures)}
        self._focal_px = known_focal_lengths(cache.cameras)
        self._beacons = _add_beacons(colmap, cache)

    def solve(self, model: Any, *, options: Any, prior_options: Any, wider: float) -> None:
        """Adjust a model, with the standard deviations of known positions multiplied by `wider`."""
        photos = self._photos(model)
        sigma, height = self._sigma_by_points(photos), self._heights(photos)
        priors = [
            self._prior_of(image, height.get(image.image_id), shows=n in sigma, wider=wider)
            for n, image in photos.image.items()
        ]
        priors = [prior for prior in priors if prior is not None] + self._raise_beacons(model)
        there = self._colmap.Reconstruction(model)
        config = self._colmap.BundleAdjustmentConfig()
        lenses = add_lens_priors(
            self._colmap, there, focal_px=self._focal_px, height_sigmas=self._height_sigmas(photos)
        )
        for id, point in lenses:
            config.set_constant_rig_from_world_pose(there.image(id).frame_id)
            config.add_constant_point(point)
        for id in self._show_points(there, photos, wider=wider):
            config.set_constant_cam_intrinsics(there.image(id).camera_id)
            if there.image(id).is_ref_in_frame():
                config.set_constant_rig_from_world_pose(there.image(id).frame_id)
        for id in there.reg_image_ids():
            config.add_image(id)
        create = self._colmap.create_pose_prior_bundle_adjuster
        create(options, prior_options, config, priors, there).solve()
        _take_over(there, model)
        for id in self._beacons:
            model.deregister_frame(id)

    def sigma_of_cameras(self, model: Any) -> dict[int, Array]:
        """Compute the standard deviations (3,) of positions known from placements, control points and
        altitudes, by image id, infinite where unknown; one image per panorama."""
        photos = self._photos(model)
        by_points, height = self._sigma_by_points(photos), self._heights(photos)
        found = {}
        for n, image in photos.image.items():
            both = [sigma for sigma in (by_points.get(n), self._sigma_of(image)) if sigma]
            level = float(np.sum(np.array(both) ** -2.0) ** -0.5) if both else np.inf
            usual = self._positions.height_sigma_px if both else np.inf
            _, up = height.get(image.image_id, (0.0, usual))
            found[image.image_id] = np.array([level, level, up])
        return found

    def _heights(self, photos: _Photos) -> dict[int, tuple[float, float]]:
        """Compute known heights along the z axis, with standard deviations, by image id.

        The level of each flight is where the model has it: only differences are known.
        """
        heights, found = self._positions.heights, dict[int, tuple[float, float]]()
        images = [*photos.image.values()]
        row = np.array([self._row[image.name] for image in images], np.int64)
        for flight in np.unique(heights.flight[row]).tolist():
            of_flight = np.flatnonzero(heights.flight[row] == flight)
            if flight < 0:
                continue
            up = heights.height_px[row[of_flight]]
            level = np.median(photos.submodel.centre[of_flight, 2] + up)
            sigma = heights.sigma_px[row[of_flight]]
            for n, z, own in zip(of_flight.tolist(), (level - up).tolist(), sigma.tolist(), strict=True):
                found[images[n].image_id] = z, own
        return found

    def _sigma_of(self, image: Any) -> float | None:
        return self.placed[image.name][1] if image.name in self.placed else None

    def _sigma_by_points(self, photos: _Photos) -> dict[int, float]:
        """Compute the standard deviations of positions that follow from control points, by photo number."""
        sigma = sigma_by_points(photos.submodel, self._positions.points)
        rows = np.flatnonzero(np.isfinite(sigma)).tolist()
        return {int(photos.submodel.photo[row]): float(sigma[row]) for row in rows}

    def _photos(self, model: Any) -> _Photos:
        images = [model.image(id) for id in model.reg_image_ids()]
        images = [image for image in images if image.name in self._row and image.is_ref_in_frame()]
        row = np.array([self._row[image.name] for image in images], np.int64)
        centre = np.array([image.projection_center() for image in images]).reshape(-1, 3)
        rotation = np.array([image.cam_from_world().rotation.matrix() for image in images]).reshape(-1, 3, 3)
        photo, turn = self._positions.photo[row], self._positions.turn_deg[row]
        submodel = of_photos(Submodel(row, centre, rotation), photo=photo, turn_deg=turn)
        return _Photos(submodel, dict(zip(photo.tolist(), images, strict=True)))

    def _height_sigmas(self, photos: _Photos) -> dict[int, float]:
        """Return the known heights in standard deviations, above the mean of those photos of the flight that
        are in the model, by image id."""
        heights, images = self._positions.heights, [*photos.image.values()]
        row = np.array([self._row[image.name] for image in images], np.int64)
        ratio = heights.height_px[row] / heights.sigma_px[row]
        for flight in np.unique(heights.flight[row]):
            ratio[heights.flight[row] == flight] -= ratio[heights.flight[row] == flight].mean()
        there = zip(images, ratio.tolist(), strict=True)
        return {image.image_id: value for image, value in there if np.isfinite(value)}

    def _prior_of(
        self, image: Any, height: tuple[float, float] | None, *, shows: bool, wider: float
    ) -> Any | None:
        """Return the prior of a placed photo; of another one that shows control points or has a known height,
        the prior of its height alone."""
        z, sigma_z = (0.0, self._positions.height_sigma_px) if height is None else height
        if image.name in self.placed:
            at, sigma = self.placed[image.name]
            return self._prior(image, [*at, z], [wider * sigma, wider * sigma, sigma_z])
        if shows or height is not None:
            return self._prior(image, [*image.projection_center()[:2], z], [_ANYWHERE, _ANYWHERE, sigma_z])
        return None

    def _show_points(self, model: Any, photos: _Photos, *, wider: float) -> Iterator[int]:
        """Add the control points to a model; yield the ids of the images that are added to observe them: for
        each click one in the frame of its photo, and one from above."""
        for point in self._positions.points:
            found = triangulate(point, photos.submodel)
            if isinstance(found, NotTriangulated):
                continue
            agree = np.isin(point.photo, photos.submodel.photo[found.row])
            clicks = dict(zip(point.photo[agree].tolist(), point.ray[agree], strict=True))
            shown = [self._click(model, photos.image[photo], ray) for photo, ray in clicks.items()]
            shown.append(self._look_from_above(model, point, at=found.at, sigma_px=wider * point.sigma_px))
            track = self._colmap.Track([self._colmap.TrackElement(id, 0) for id in shown])
            model.add_point3D(found.at, track)
            yield from shown

    def _click(self, model: Any, reference: Any, ray: Array) -> int:
        """Add an image to a photo's frame that looks along a click's ray; a pixel is a standard deviation."""
        own, frame = free_id(model), model.frame(reference.frame_id)
        params = [1.0 / CLICK_RAD, 0.5, 0.5]
        camera = self._colmap.Camera(model="SIMPLE_PINHOLE", width=1, height=1, params=params, camera_id=own)
        model.add_camera(camera)
        turn = view_rotation(float(self._positions.turn_deg[self._row[reference.name]]))
        along = self._colmap.Rigid3d(self._colmap.Rotation3d(_looking_along(turn @ ray)), np.zeros(3))
        model.rig(frame.rig_id).add_sensor(camera.sensor_id, along)
        middle = np.array([[0.5, 0.5]])
        image = self._colmap.Image(name=f"click {own}", camera_id=own, image_id=own, keypoints=middle)
        image.frame_id = frame.frame_id
        frame.add_data_id(image.data_id)
        model.add_image(image)
        return own

    def _look_from_above(self, model: Any, point: KnownPoint, *, at: Array, sigma_px: float) -> int:
        """Add an image that shows a point's known position; a pixel is a standard deviation."""
        own = free_id(model)
        params = [_ABOVE, 0.5, 0.5]
        camera = self._colmap.Camera(model="SIMPLE_PINHOLE", width=1, height=1, params=params, camera_id=own)
        model.add_camera_with_trivial_rig(camera)
        middle = np.array([[0.5, 0.5]])
        image = self._colmap.Image(name=f"above {own}", camera_id=own, image_id=own, keypoints=middle)
        centre = np.array([point.at.real, point.at.imag, at[2] - _ABOVE * sigma_px])
        pose = self._colmap.Rigid3d(self._colmap.Rotation3d(np.eye(3)), -centre)
        model.add_image_with_trivial_frame(image, pose)
        return own

    def _raise_beacons(self, model: Any) -> list[Any]:
        priors = []
        where = self._positions.everything()
        middle, extent = np.append(where.mean(0), 0.0), max(float(np.ptp(where, axis=0).max()), 1.0)
        for id, corner in zip(self._beacons, _CORNERS, strict=True):
            centre, image = middle + extent * np.array(corner), model.image(id)
            pose = self._colmap.Rigid3d(self._colmap.Rotation3d(np.eye(3)), -centre)
            model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
            model.register_frame(image.frame_id)
            priors.append(self._prior(image, centre, [extent / 100.0] * 3))
        return priors

    def _prior(self, image: Any, at: Sequence[float] | Array, sigma: Sequence[float]) -> Any:
        return self._colmap.PosePrior(
            pose_prior_id=image.image_id,
            corr_data_id=image.data_id,
            position=np.asarray(at, np.float64),
            position_covariance=np.diag(np.square(sigma)),
            coordinate_system=self._colmap.PosePriorCoordinateSystem.CARTESIAN,
        )


def _looking_along(ray: Array) -> Array:
    """Compute a rotation (3, 3) that takes a unit vector to the z axis."""
    right = np.cross(np.eye(3)[np.abs(ray).argmin()], ray)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ray, right), ray])


def _take_over(adjusted: Any, model: Any) -> None:
    """Copy poses, lenses and points to a model from its adjusted copy, which has additional ones."""
    for id, camera in model.cameras.items():
        camera.params = adjusted.camera(id).params
    for id in model.reg_frame_ids():
        model.frame(id).rig_from_world = adjusted.frame(id).rig_from_world
    for id, point in model.points3D.items():
        point.xyz = adjusted.point3D(id).xyz


def _add_beacons(colmap: Any, cache: Any) -> list[int]:
    own = 1 + max([*cache.cameras, *cache.rigs])
    params = [1.0, 0.5, 0.5]
    camera = colmap.Camera(model="SIMPLE_PINHOLE", width=1, height=1, params=params, camera_id=own)
    rig = colmap.Rig(rig_id=own)
    rig.add_ref_sensor(camera.sensor_id)
    cache.add_camera(camera)
    cache.add_rig(rig)
    last = max([*cache.images, *cache.frames])
    ids = [last + number for number in range(1, 5)]
    for id in ids:
        image = colmap.Image(name=f"beacon {id}", camera_id=own, image_id=id)
        frame = colmap.Frame(frame_id=id, rig_id=own)
        frame.add_data_id(image.data_id)
        image.frame_id = id
        cache.add_frame(frame)
        cache.add_image(image)
    return ids
