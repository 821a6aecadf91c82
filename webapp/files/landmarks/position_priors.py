"""What is known of where cameras are, as pycolmap's bundle adjustment takes it."""

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
from webapp.core.landmarks.submodels import Submodel, of_photos, turn_of_view

Array = NDArray[np.float64]

_ABOVE = 1e5
"""Height over a control point from which the map's image shows it, in standard deviations of its place."""

_ANYWHERE = 1e9
"""Standard deviation of what is not known, map pixels."""

_CORNERS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))


@dataclass(frozen=True, slots=True, eq=False)
class PicturePositions:
    """What is known of where pictures are on a map; the world is that of the map, see `AdjustJob`.

    Attributes
    ----------
    pictures : tuple of str
        The p pictures that take part.
    photo : (p,) int64
        Numbers of their photos; the views of a panorama share one.
    turn_deg : (p,) int64
        By how much each is turned clockwise from the middle of its panorama; 0 for a photo that is none.
    known : tuple of str
        The k of them whose positions are known.
    at : (k, 2) float64
    sigma_px : (k,) float64
        Standard deviation of each, along both axes.
    height_sigma_px : float
        Standard deviation of the heights of the cameras, which no map says.
    points : tuple of KnownPoint
        Control points that they show, by the numbers of the photos.
    """

    pictures: tuple[str, ...]
    photo: NDArray[np.int64]
    turn_deg: NDArray[np.int64]
    known: tuple[str, ...]
    at: Array
    sigma_px: Array
    height_sigma_px: float
    points: tuple[KnownPoint, ...] = ()

    def everything(self) -> Array:
        """List all known places, (k + points, 2)."""
        points = np.array([[point.at.real, point.at.imag] for point in self.points])
        return np.concatenate([self.at, points.reshape(-1, 2)])


class _Photos(NamedTuple):
    """Of a model: as a submodel, and the images to which their frames refer by their numbers."""

    submodel: Submodel
    image: Mapping[int, Any]


class PositionPriors:
    """Known positions for the adjustment of a model.

    Placed photos have priors of pycolmap's. A control point becomes a point of the model that the map's image
    shows, too: that is a camera far above it, which looks straight down and does not move.

    Parameters
    ----------
    cache : pycolmap.DatabaseCache
        To which beacons are added: four photos that see nothing, for the corners of a tetrahedron. Before it
        adjusts, pycolmap fits a similarity to the known positions, and refuses those of cameras that are all
        equally high. Beacons are off that plane, and as the model is where it should be they say so.
    """

    def __init__(self, colmap: Any, *, cache: Any, positions: PicturePositions) -> None:
        self._colmap, self._positions = colmap, positions
        placed = zip(positions.known, positions.at, positions.sigma_px, strict=True)
        self.placed: Mapping[str, tuple[Array, float]] = {name: (at, sigma) for name, at, sigma in placed}
        self._row = {name: row for row, name in enumerate(positions.pictures)}
        self._beacons = _add_beacons(colmap, cache)

    def solve(self, model: Any, *, options: Any, prior_options: Any, wider: float) -> None:
        """Adjust a model, as if positions were less exact by a factor."""
        photos = self._photos(model)
        sigma = self._sigma_by_points(photos)
        priors = [self._prior_of(image, shows=n in sigma, wider=wider) for n, image in photos.image.items()]
        priors = [prior for prior in priors if prior is not None] + self._raise_beacons(model)
        there = self._colmap.Reconstruction(model) if self._positions.points else model
        config = self._colmap.BundleAdjustmentConfig()
        for id in self._show_points(there, photos, wider=wider):
            config.set_constant_cam_intrinsics(there.image(id).camera_id)
            if there.image(id).is_ref_in_frame():
                config.set_constant_rig_from_world_pose(there.image(id).frame_id)
        for id in there.reg_image_ids():
            config.add_image(id)
        create = self._colmap.create_pose_prior_bundle_adjuster
        create(options, prior_options, config, priors, there).solve()
        if there is not model:
            _take_over(there, model)
        for id in self._beacons:
            model.deregister_frame(id)

    def sigma_of_cameras(self, model: Any) -> dict[int, float]:
        """Say how exactly images of a model are known, by their ids, one of each panorama: placed photos, and
        those that show control points, which are known of them."""
        photos = self._photos(model)
        by_points = self._sigma_by_points(photos)
        both = {
            image.image_id: [sigma for sigma in (by_points.get(n), self._sigma_of(image)) if sigma]
            for n, image in photos.image.items()
        }
        return {id: float(np.sum(np.array(known) ** -2.0) ** -0.5) for id, known in both.items() if known}

    def _sigma_of(self, image: Any) -> float | None:
        return self.placed[image.name][1] if image.name in self.placed else None

    def _sigma_by_points(self, photos: _Photos) -> dict[int, float]:
        """Say how exactly control points say where photos are that show them, by their numbers."""
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

    def _prior_of(self, image: Any, *, shows: bool, wider: float) -> Any | None:
        """Give the prior of a photo that is placed, or that shows a control point: then of its height."""
        height = self._positions.height_sigma_px
        if image.name in self.placed:
            at, sigma = self.placed[image.name]
            return self._prior(image, [*at, 0.0], [wider * sigma, wider * sigma, height])
        if shows:
            return self._prior(image, [*image.projection_center()[:2], 0.0], [_ANYWHERE, _ANYWHERE, height])
        return None

    def _show_points(self, model: Any, photos: _Photos, *, wider: float) -> Iterator[int]:
        """Add the control points to a model; gives the ids of the images that show nothing else: for each
        click one in the frame of its photo, and one from above."""
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
        """Add an image to a photo's frame that looks along a click, a pixel for each standard deviation."""
        own, frame = _free_id(model), model.frame(reference.frame_id)
        params = [1.0 / CLICK_RAD, 0.5, 0.5]
        camera = self._colmap.Camera(model="SIMPLE_PINHOLE", width=1, height=1, params=params, camera_id=own)
        model.add_camera(camera)
        turn = turn_of_view(float(self._positions.turn_deg[self._row[reference.name]]))
        along = self._colmap.Rigid3d(self._colmap.Rotation3d(_looking_along(turn @ ray)), np.zeros(3))
        model.rig(frame.rig_id).add_sensor(camera.sensor_id, along)
        middle = np.array([[0.5, 0.5]])
        image = self._colmap.Image(name=f"click {own}", camera_id=own, image_id=own, keypoints=middle)
        image.frame_id = frame.frame_id
        frame.add_data_id(image.data_id)
        model.add_image(image)
        return own

    def _look_from_above(self, model: Any, point: KnownPoint, *, at: Array, sigma_px: float) -> int:
        """Add an image that shows the place of a point, a pixel for each standard deviation."""
        own = _free_id(model)
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


def _free_id(model: Any) -> int:
    return 1 + int(max([*model.cameras, *model.images, *model.frames, *model.rigs]))


def _looking_along(ray: Array) -> Array:
    """Rotate (3, 3) a unit vector to the z axis."""
    right = np.cross(np.eye(3)[np.abs(ray).argmin()], ray)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ray, right), ray])


def _take_over(adjusted: Any, model: Any) -> None:
    """Give a model the poses, lenses and points of another one that has more."""
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
