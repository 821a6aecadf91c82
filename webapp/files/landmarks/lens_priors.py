"""Known focal lengths as priors of pycolmap's bundle adjustment, which has none for lenses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

_SIGMA = 0.1
"""Relative standard deviation of a focal length by EXIF: it is rounded to whole millimetres in 35 mm film,
and cameras disagree on what it is of a photo that is cropped to 16:9."""

_SHARE = 0.01
"""Number of times that the prior counts, as a share of the observations. Their errors are not independent:
where they hardly depend on the focal length, as over flat ground, distortions and rolling shutters would make
it wrong."""

_LEVELS = 2.0
"""RMS of the heights, in standard deviations, from which on they fix the focal length, as their differences
have its scale: the prior then counts as little as possible."""

_LEAST = 2
"""pycolmap accepts no point that is observed only once."""

_DEPTH = 1000.0


def known_focal_lengths(cameras: Mapping[int, Any]) -> dict[int, float]:
    """Return the focal lengths, pixels, of those lenses for which they are known, by the camera's id."""
    return {id: float(one.params[0]) for id, one in cameras.items() if one.has_prior_focal_length}


def add_lens_priors(
    colmap: Any, model: Any, *, focal_px: Mapping[int, float], height_sigmas: Mapping[int, float]
) -> Iterator[tuple[int, int]]:
    """Add to a model, for each lens in use, an image through it of a fixed point next to the optical axis.

    As its pose is fixed, where the point is in the image depends on the focal length alone: a pixel is a
    standard deviation.

    Args:
        height_sigmas: By image, how far it is above the mean of its flight in the model, in standard
            deviations.

    Yields:
        image, point: Their ids.
    """
    images: dict[int, list[Any]] = {}
    for id in model.reg_image_ids():
        images.setdefault(model.image(id).camera_id, []).append(model.image(id))
    alone = {rig.ref_sensor_id.id for rig in model.rigs.values() if rig.num_sensors() == 1}
    for camera_id, focal in focal_px.items():
        some = images.get(camera_id, [])
        if not some or camera_id not in alone:  # the views of a panorama have no lens
            continue
        spread = np.mean([height_sigmas.get(image.image_id, 0.0) ** 2 for image in some]) ** 0.5
        observations = sum(image.num_points3D for image in some)
        times = _LEAST if spread >= _LEVELS else max(_LEAST, round(_SHARE * observations))
        camera = model.camera(camera_id)
        own = free_id(model)
        at = np.array([camera.principal_point_x + 1.0 / _SIGMA, camera.principal_point_y])
        image = colmap.Image(
            name=f"lens {own}", camera_id=camera_id, image_id=own, keypoints=np.tile(at, (times, 1))
        )
        model.add_image_with_trivial_frame(image, colmap.Rigid3d())
        track = colmap.Track([colmap.TrackElement(own, number) for number in range(times)])
        yield own, model.add_point3D(_DEPTH * np.array([1.0 / _SIGMA / focal, 0.0, 1.0]), track)


def free_id(model: Any) -> int:
    """Return an id that no part of a model has."""
    return 1 + int(max([*model.cameras, *model.images, *model.frames, *model.rigs]))
