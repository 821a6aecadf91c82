"""The answer to "where was this photo taken?", as every view of it needs it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.camera_pose import CameraPose
from webapp.core.geometry.estimate import NoPose


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One place where the photo may have been taken.

    Attributes
    ----------
    rank : int
        From 1, most probable first.
    kind : {"position", "photo", "area"}
        "position": computed from what it shares with map photos; "photo": the place of one is all that is
        known; "area": the photos stand for a place as a whole, and so does the answer.
    probability : float
        That the truth lies within the map's `place_radius_px` of `position`; 0 to 1.
    radius_px : float or None
        Radius that holds the truth in 68 % of the cases, given that the hypothesis is right; map pixels.
    heading_deg : float or None
        Where the camera looked, degrees clockwise from north.
    experiences : tuple of int
        Ids of the map photos that speak for it, the best first.
    inliers : int or None
        Matches with the best photo that agree on one geometry; None where no geometry was checked.
    matches : int
        Matches that speak for it before any geometry.
    camera : CameraPose or None
        How the camera was held, where that was solved from landmarks.
    floor : int
        Id of the floor that it is on.
    """

    rank: int
    kind: Literal["position", "photo", "area"]
    position: MapPixel
    probability: float
    radius_px: float | None
    heading_deg: float | None
    experiences: tuple[int, ...]
    inliers: int | None
    matches: int
    camera: CameraPose | None = None
    floor: int = BASE_FLOOR


@dataclass(frozen=True, slots=True)
class MatchStatistics:
    """What the matching looked like before anybody interpreted it.

    Distances are in the units of the matcher's norm, over all matches, and None when there was no match.

    Attributes
    ----------
    matches_pruned : int
        Matches that pruning left.
    """

    keypoints: int
    matches: int
    matches_pruned: int
    distance_min: float | None
    distance_max: float | None
    distance_mean: float | None
    distance_total: float | None


@dataclass(frozen=True, slots=True)
class Evidence:
    """The matches between the query and one map photo.

    Attributes
    ----------
    experience : int
        Id of the map photo.
    query_xy, photo_xy : (n, 2) float32
        Matched points, pixels of the upright query and of the upright map photo, both at full size.
    inlier : (n,) bool
        Which of them agree on one geometry; all False where none was found or none was looked for.
    """

    experience: int
    query_xy: NDArray[np.float32]
    photo_xy: NDArray[np.float32]
    inlier: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """Horizontal field of view of an upright photo, and how it is known.

    Attributes
    ----------
    source : {"option", "exif", "guess"}
    """

    degrees: float
    source: Literal["option", "exif", "guess"]


@dataclass(frozen=True, slots=True)
class Answer:
    """All hypotheses about one photo, and what speaks for them.

    Attributes
    ----------
    hypotheses : tuple of Hypothesis
        The most probable first; may be empty.
    off_map_probability : float or None
        That the photo was not taken on this map. None where the method does not know (`vote`).
        The hypotheses' probabilities, `other_probability` and this add up to 1.
    other_probability : float
        Of the places that the caller's limit cut from the list.
    no_pose : NoPose or None
        Why there is no hypothesis, when there is none.
    evidence : tuple of Evidence
        The matches with the best hypothesis' photos, the best first; then those with the best photo of each
        further hypothesis, as far as the method knows them.
    seconds : dict of str to float
        Time of each stage: read, extract, retrieve, verify, position, total.
    fov : FieldOfView or None
        Of the query; None where the method does not ask for it.
    looks : tuple of str
        Features that were used, in order; where the first were sure, there are no others.
    quarter_turns : int
        Clockwise, that bring the query upright; 0 where its keypoints show none.
    note : str
        Why there is less than was asked for; empty where there is not.
    """

    hypotheses: tuple[Hypothesis, ...]
    off_map_probability: float | None
    other_probability: float
    no_pose: NoPose | None
    statistics: MatchStatistics
    evidence: tuple[Evidence, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    fov: FieldOfView | None = None
    looks: tuple[str, ...] = ()
    quarter_turns: int = 0
    note: str = ""

    @property
    def abstained(self) -> bool:
        """True when the answer is "not on this map": no hypothesis, or off-map more probable than each."""
        best = self.hypotheses[0].probability if self.hypotheses else None
        return is_off_map(best, self.off_map_probability)


def is_off_map(best: float | None, off: float | None) -> bool:
    """Decide whether an answer says "not on this map".

    Parameters
    ----------
    best : float or None
        Probability of its first hypothesis; None where it has none.
    off : float or None
        Probability that the photo is of another place; None where that is unknown.
    """
    return best is None or (off is not None and off > best)
