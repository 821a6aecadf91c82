"""Kind and place radius of a map, from the positions of its photos.

On a *metric* map positions are where the photos were taken. On a map of *areas* (rooms, floors, parts of a
park) many photos share one position. A *mixed* map has both. A *schematic* map, a plan that is not to scale,
is recognised only when positions are computed on it: see `tasks.localize.calibrate`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.extrinsics import MIN_TRUST

MapKind = Literal["metric", "areas", "schematic", "mixed"]
MAP_KINDS: tuple[MapKind, ...] = get_args(MapKind)

KIND_WORDS: dict[MapKind, str] = {
    "metric": "a metric map",
    "areas": "a map of areas",
    "schematic": "a schematic map",
    "mixed": "a map of places and areas",
}
"""Names of the kinds in reports."""

RADIUS_OVER_SPACING = 2.0
AREA_RADIUS_OVER_SPACING = 0.4
"""Less than half, so that areas never overlap."""

_SHARE_OF_SIDE = 0.05

_FEWEST_MATCHED = 10
"""Minimum number of photos with certain matches for judging how accurate positions are."""

_SHARED = 3
"""Minimum number of photos at a position that may be an area."""

_PANORAMA = 12
"""Maximum number of photos of a panorama: a position with more is an area."""

_CONFIRMED = 0.6
"""Share of photos at shared positions whose poses must agree; with less, these positions are areas, too."""

_FEW, _MOST = 0.1, 0.9
"""Share of photos in areas up to which a map is metric, and from which on it is a map of areas."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPlaces:
    """Kind of a map, its areas and its place radius."""

    kind: MapKind
    # (p,) int64. Number of each photo's area; -1 for a photo at the position where it was taken.
    area: NDArray[np.int64]
    radius_px: float  # Place radius: maximum error of an answer that names the right place


@dataclass(frozen=True, slots=True, eq=False)
class PhotoGroups:
    """Experience and floor of each photo."""

    # (p,) int64. Number of each photo's experience: all views of a panorama are one.
    experience: NDArray[np.int64]
    # (p,) int64. Id of each photo's floor: positions above each other are different places.
    floor: NDArray[np.int64]


def describe_places(
    position: NDArray[np.float64],
    *,
    trust: NDArray[np.float64] | None,
    size: tuple[int, int],
    kind: MapKind | None = None,
    partner: NDArray[np.int64] | None = None,
    groups: PhotoGroups | None = None,
) -> MapPlaces:
    """Determine the kind, areas and place radius of a map.

    Three or more photos at one position are an area if they are more than a panorama has, or if relative
    poses between positions do not agree with the positions; where several photos were taken from one spot,
    they agree. If there are enough of them, only photos that certainly match one elsewhere decide: on a
    sparse map most photos have no such match, which is no contradiction.

    Args:
        position: (p, 2) float64. Positions of the map's photos, map pixels.
        trust: (p,) float64 or None. As in `MapExtrinsics`; None while relative poses are unknown.
        size: Width and height of the satellite image.
        kind: Kind stated by the user.
        partner: (p,) int64. As in `MapExtrinsics`: where positions are noisy, e.g. from GPS, photos of one
            view are far apart.
        groups: By default each photo is a separate experience, and all are on one floor.
    """
    if groups is None:
        groups = PhotoGroups(np.arange(len(position)), np.zeros(len(position), np.int64))
    own, on = groups.experience, groups.floor
    width, height = size
    if kind in (None, "mixed"):
        area = _areas(_number_positions(position, on), trust, partner, experience=own)
    else:
        area = _all_areas(_number_positions(position, on), kind == "areas")
    share = float((area >= 0).mean()) if len(area) else 0.0
    if share <= _FEW:
        area = np.full(len(position), -1, np.int64)
        radius = place_radius_px(position, width=width, height=height, floor=on)
        return MapPlaces(kind or "metric", area, max(radius, _noise_px(position, partner)))
    side = _SHARE_OF_SIDE * max(width, height)
    spacing = spacing_px(position, of=area >= 0, floor=on)
    radius = side if spacing is None else AREA_RADIUS_OVER_SPACING * spacing
    if share >= _MOST:
        return MapPlaces(kind or "areas", area, radius)
    metric = place_radius_px(position[area < 0], width=width, height=height, floor=on[area < 0])
    if partner is not None:
        alone = (area < 0) & (area[partner] < 0)
        metric = max(metric, _noise_px(position, np.where(alone, partner, -1)))
    return MapPlaces("mixed", area, share * radius + (1.0 - share) * metric)


def _number_positions(position: NDArray[np.float64], floor: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the distinct positions on each floor; (p,)."""
    if not len(position):
        return np.zeros(0, np.int64)
    spots = np.column_stack([position, floor])
    return np.unique(spots, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _all_areas(number: NDArray[np.int64], areas: bool) -> NDArray[np.int64]:
    """Return the number of each photo's area if all distinct positions are areas, else -1; (p,)."""
    return number if areas else np.full(len(number), -1, np.int64)


def _areas(
    number: NDArray[np.int64],
    trust: NDArray[np.float64] | None,
    partner: NDArray[np.int64] | None,
    *,
    experience: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Find which of the numbered positions are areas; (p,), -1 for photos in none."""
    none = np.full(len(number), -1, np.int64)
    if not len(number):
        return none
    one_each = np.unique(experience, return_index=True)[1]
    count = np.bincount(number[one_each], minlength=number.max() + 1)
    large, shared = count[number] > _PANORAMA, count[number] >= _SHARED
    stands = shared & ~large
    # A map with large areas has small ones, too, even if photos of neighbouring areas match: use all photos.
    sure = None if partner is None or large.any() else partner >= 0
    return np.where(large if _are_confirmed(stands, trust, sure=sure) else shared, number, none)


def _are_confirmed(
    stands: NDArray[np.bool_], trust: NDArray[np.float64] | None, *, sure: NDArray[np.bool_] | None
) -> bool:
    """Check whether relative poses confirm the shared positions of the photos `stands`, (p,).

    Args:
        sure: (p,) bool or None. Photos with certain matches: if enough of them are in `stands`, only they
            decide.
    """
    if trust is None or not stands.any():
        return True
    deciding = stands if sure is None else stands & sure
    if deciding.sum() < _FEWEST_MATCHED:
        deciding = stands
    return float((trust[deciding] >= MIN_TRUST).mean()) >= _CONFIRMED


def _noise_px(position: NDArray[np.float64], partner: NDArray[np.int64] | None) -> float:
    """Compute the median distance between photos of one view; 0 if too few are known."""
    if partner is None:
        return 0.0
    matched = np.flatnonzero(partner >= 0)
    if len(matched) < _FEWEST_MATCHED:
        return 0.0
    return float(np.median(np.hypot(*(position[matched] - position[partner[matched]]).T)))


def spacing_px(
    position: NDArray[np.float64],
    *,
    of: NDArray[np.bool_] | None = None,
    floor: NDArray[np.int64] | None = None,
) -> float | None:
    """Compute the median distance from each distinct position to its nearest neighbour.

    Args:
        position: (p, 2) float64. Map pixels.
        of: (p,) bool. Only from these positions.
        floor: (p,) int64. Ids of their floors: neighbours are on the same floor.

    Returns:
        None if no floor has two distinct positions.
    """
    on = np.zeros(len(position), np.int64) if floor is None else floor
    asked = np.ones(len(position), np.bool_) if of is None else of
    away = [_nearest_px(position[on == one], of=asked[on == one]) for one in np.unique(on)]
    known = np.concatenate(away) if away else np.zeros(0, np.float32)
    return float(np.median(known)) if len(known) else None


def _nearest_px(position: NDArray[np.float64], *, of: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Compute the distance from each distinct position `of` to its nearest neighbour; empty without any."""
    distinct = np.unique(position, axis=0).astype(np.float32)
    if len(distinct) < 2 or not of.any():
        return np.zeros(0, np.float32)
    asked = np.unique(position[of], axis=0).astype(np.float32)
    trees = cv2.flann_Index(distinct, {"algorithm": 4})
    _, squared = trees.knnSearch(asked, 2, params={"checks": -1})
    return np.asarray(np.sqrt(squared[:, 1]), np.float32)


def place_radius_px(
    position: NDArray[np.float64],
    *,
    width: int,
    height: int,
    floor: NDArray[np.int64] | None = None,
) -> float:
    """Compute the place radius of a map whose positions are where the photos were taken.

    Args:
        position: (p, 2) float64. Positions of the map's photos, map pixels.
        width, height: Size of the satellite image.
        floor: (p,) int64. Ids of their floors.

    Returns:
        Twice the median distance between neighbouring distinct positions; with fewer than two positions a
            twentieth of the image's longer side.
    """
    spacing = spacing_px(position, floor=floor)
    if spacing is None:
        return _SHARE_OF_SIDE * max(width, height)
    return RADIUS_OVER_SPACING * spacing
