"""Known positions of photos, with standard deviations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from webapp.core.landmarks.placing import KnownPositions
from webapp.core.landmarks.radii import RADIUS_OVER_SIGMA
from webapp.core.mapmodel.accuracy import position_radius_px
from webapp.core.mapmodel.model import Experience, Map, UnplacedPhoto
from webapp.core.mapmodel.panorama import experience_of

_CLICK_PX, _CLICK_SHARE = 1.0, 0.001
"""Standard deviation of a clicked position along each axis: in map pixels, and as a fraction of the longer
side of the image, as a large image is clicked on where it is shown reduced. The larger one counts."""

AnyPhoto = Experience | UnplacedPhoto


def all_photos(the_map: Map) -> list[AnyPhoto]:
    """List the photos of a map, those in its tray last."""
    return [*the_map.experiences, *the_map.unplaced]


def known_positions(photos: Sequence[AnyPhoto | None], the_map: Map) -> KnownPositions:
    """Collect the positions of photos with standard deviations; NaN for None and unplaced photos.

    Of the views of a panorama only the first gets the position: they share it, and are not independent.
    """
    seen: set[int] = set()
    at = np.full(len(photos), complex(math.nan, math.nan))
    click = max(_CLICK_PX, _CLICK_SHARE * max(the_map.satellite.width, the_map.satellite.height))
    sigma = np.full(len(photos), click)
    derived = np.zeros(len(photos), np.bool_)
    for number, photo in enumerate(photos):
        if isinstance(photo, Experience) and experience_of(photo.id) not in seen:
            seen.add(experience_of(photo.id))
            at[number] = complex(*photo.position)
            sigma[number] = max(position_radius_px(photo, the_map) / RADIUS_OVER_SIGMA, click)
            derived[number] = photo.radius_px is not None
    return KnownPositions(at, sigma, derived)
