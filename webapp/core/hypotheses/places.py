"""What counts as one place, and what kind of map the positions of its photos make.

On a *metric* map photos stand where they were taken. On a map of *areas* (rooms, floors, parts of a park)
many photos stand for one place. A *mixed* map has both. Whether a map is *schematic*, a plan that is not to
scale, shows only when positions are computed on it: see `tasks.localize.calibrate`.
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
"""What reports call a map of each kind."""

RADIUS_OVER_SPACING = 2.0
AREA_RADIUS_OVER_SPACING = 0.4
"""Less than half: areas never overlap."""

_SHARE_OF_SIDE = 0.05

_FEWEST_MATCHED = 10
"""Photos that certainly match others from which on their distances say how exact positions are."""

_SHARED = 3
"""Photos at one position from which on it may be an area."""

_PANORAMA = 12
"""More photos at one position than anybody takes of a panorama: an area."""

_CONFIRMED = 0.6
"""Share of the photos at shared positions whose relative poses agree with these: then they are true."""

_FEW, _MOST = 0.1, 0.9
"""Share of photos in areas up to which a map is metric, and from which on it is one of areas."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPlaces:
    """What kind of map the positions make.

    Attributes
    ----------
    area : (p,) int64
        For each photo the number of its area; -1 where it stands where it was taken.
    radius_px : float
        How far from the truth an answer may be and still name the right place.
    """

    kind: MapKind
    area: NDArray[np.int64]
    radius_px: float


@dataclass(frozen=True, slots=True, eq=False)
class PhotoGroups:
    """Which photos belong together.

    Attributes
    ----------
    experience : (p,) int64
        Of which experience each photo is: views of one panorama are one.
    floor : (p,) int64
        Id of each photo's floor: what is above each other is not one place.
    """

    experience: NDArray[np.int64]
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
    """Find out what kind of map it is.

    Photos at a position that they share with two others are an area where they are more than a panorama has,
    or where relative poses between positions do not agree with the positions: at a stand from which somebody
    took five photos they do. Photos that certainly show the same as one elsewhere decide, where there are
    enough of them: on a thin map most see what no other does, which contradicts nothing.

    Parameters
    ----------
    position : (p, 2) float64
        Of the map's photos, map pixels.
    trust : (p,) float64 or None
        As `MapExtrinsics` has it; None while relative poses are not known.
    size : (int, int)
        Width and height of the satellite image.
    kind : MapKind, optional
        What the user says it is.
    partner : (p,) int64, optional
        As `MapExtrinsics` has it: where positions are noisy, as by GPS, photos of one view are far apart.
    groups : PhotoGroups, optional
        By default each photo is an experience of its own, and all are on one floor.
    """
    if groups is None:
        groups = PhotoGroups(np.arange(len(position)), np.zeros(len(position), np.int64))
    own, on = groups.experience, groups.floor
    width, height = size
    if kind in (None, "mixed"):
        area = _areas(_stands(position, on), trust, partner, experience=own)
    else:
        area = _all_areas(_stands(position, on), kind == "areas")
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


def _stands(position: NDArray[np.float64], floor: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the distinct positions on each floor; (p,)."""
    if not len(position):
        return np.zeros(0, np.int64)
    spots = np.column_stack([position, floor])
    return np.unique(spots, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _all_areas(number: NDArray[np.int64], areas: bool) -> NDArray[np.int64]:
    """Take each distinct position for an area, or none; (p,)."""
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
    # On a map of areas small ones are areas, too, also where photos of neighbouring ones show the same.
    sure = None if partner is None or large.any() else partner >= 0
    return np.where(large if _are_confirmed(stands, trust, sure=sure) else shared, number, none)


def _are_confirmed(
    stands: NDArray[np.bool_], trust: NDArray[np.float64] | None, *, sure: NDArray[np.bool_] | None
) -> bool:
    """Check whether relative poses agree with the positions of the stands, (p,).

    Parameters
    ----------
    sure : (p,) bool or None
        Photos that decide, where enough of them are at stands.
    """
    if trust is None or not stands.any():
        return True
    deciding = stands if sure is None else stands & sure
    if deciding.sum() < _FEWEST_MATCHED:
        deciding = stands
    return float((trust[deciding] >= MIN_TRUST).mean()) >= _CONFIRMED


def _noise_px(position: NDArray[np.float64], partner: NDArray[np.int64] | None) -> float:
    """Compute the median distance between photos of one view; 0 where too few are known."""
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
    """Compute the median distance from each distinct position to the nearest other.

    Parameters
    ----------
    position : (p, 2) float64
        Map pixels.
    of : (p,) bool, optional
        Only for these of them.
    floor : (p,) int64, optional
        Ids of their floors: the nearest other is on the same one.

    Returns
    -------
    float or None
        None when there are fewer than two distinct positions, on one floor.
    """
    on = np.zeros(len(position), np.int64) if floor is None else floor
    asked = np.ones(len(position), np.bool_) if of is None else of
    away = [_nearest_px(position[on == one], of=asked[on == one]) for one in np.unique(on)]
    known = np.concatenate(away) if away else np.zeros(0, np.float32)
    return float(np.median(known)) if len(known) else None


def _nearest_px(position: NDArray[np.float64], *, of: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Compute the distance from each distinct position to the nearest other; none where there is no other."""
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
    """Choose the place radius of a map whose photos stand where they were taken.

    Parameters
    ----------
    position : (p, 2) float64
        Of the map's photos, map pixels.
    width, height : int
        Of the satellite image.
    floor : (p,) int64, optional
        Ids of their floors.

    Returns
    -------
    float
        Twice the median distance between neighbouring distinct positions; with fewer than two positions
        a twentieth of the image's longer side.
    """
    spacing = spacing_px(position, floor=floor)
    if spacing is None:
        return _SHARE_OF_SIDE * max(width, height)
    return RADIUS_OVER_SPACING * spacing
