"""Data model of the answer to "where was this photo taken?"."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR, Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.places import MapKind


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Pose of a camera on the map; position and heading are in the hypothesis."""

    height_px: float  # Height above the camera of the nearest placed photo, map pixels
    pitch_deg: float  # Angle of the line of sight above the horizon
    roll_deg: float  # Clockwise rotation of the camera about its line of sight; 0 if its x axis is level
    # (6, 6) float64. Of x, y and height, map pixels, and of heading, pitch and roll, degrees.
    covariance: NDArray[np.float64]
    landmarks: int  # Number of landmarks that agree on it


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One place where the photo may have been taken."""

    rank: int  # From 1, most probable first
    # "position": computed from matches with map photos; "photo": only the position of a matching photo is
    # known; "area": the area as a whole, whose photos share one position.
    kind: Literal["position", "photo", "area"]
    position: MapPixel
    probability: float  # That the truth lies within the map's `place_radius_px` of `position`; 0 to 1
    # Radius that contains the truth in 68 % of cases, given that the hypothesis is right; map pixels.
    radius_px: float | None
    heading_deg: float | None  # Viewing direction, degrees clockwise from north
    experiences: tuple[int, ...]  # Ids of the map photos that support it, the best first
    # Matches with the best photo that agree on one geometry; None where no geometry was checked.
    inliers: int | None
    matches: int  # Matches that support it, before geometric verification
    camera: CameraPose | None = None  # Height and orientation of the camera, if solved from landmarks
    floor: int = BASE_FLOOR  # Id of its floor


@dataclass(frozen=True, slots=True)
class MatchStatistics:
    """Statistics of the raw matches.

    Distances are in the units of the matcher's norm, over all matches; None if there was no match.
    """

    keypoints: int
    matches: int
    matches_pruned: int  # Matches left after pruning
    distance_min: float | None
    distance_max: float | None
    distance_mean: float | None
    distance_total: float | None


@dataclass(frozen=True, slots=True)
class Evidence:
    """The matches between the query and one map photo."""

    experience: int  # Id of the map photo
    # `query_xy`, `photo_xy`: (n, 2) float32. Matched points, pixels of the upright query and of the upright
    # map photo, both at full size.
    query_xy: NDArray[np.float32]
    photo_xy: NDArray[np.float32]
    # (n,) bool. Which of them agree on one geometry; all False if none was found or sought.
    inlier: NDArray[np.bool_]


_FOCAL_SIGMA = {"option": 0.01, "exif": 0.03, "guess": 0.15}


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """Horizontal field of view of an upright photo, and its source."""

    degrees: float
    source: Literal["option", "exif", "guess"]  #

    @property
    def focal_sigma(self) -> float:
        """Standard deviation of the focal length, as a fraction of it."""
        return _FOCAL_SIGMA[self.source]


@dataclass(frozen=True, slots=True)
class Answer:
    """All hypotheses about one photo, and the evidence for them."""

    hypotheses: tuple[Hypothesis, ...]  # The most probable first; may be empty
    # That the photo was not taken on this map. None if the method does not estimate it (`vote`). The
    # hypotheses' probabilities, `other_probability` and this add up to 1.
    off_map_probability: float | None
    other_probability: float  # Total of the places that the caller's limit cut from the list
    no_pose: NoPose | None  # Why there is no hypothesis, if there is none
    statistics: MatchStatistics
    # The matches with the best hypothesis' photos, the best first; then those with the best photo of each
    # further hypothesis, if the method has them.
    evidence: tuple[Evidence, ...] = ()
    # Time of each stage: read, extract, retrieve, verify, position, total.
    seconds: dict[str, float] = field(default_factory=dict)
    fov: FieldOfView | None = None  # Of the query; None if the method does not use it
    # Features of each look, in order; there is no further look after a certain one.
    looks: tuple[str, ...] = ()
    # Clockwise quarter turns that bring the query upright; 0 if its keypoints show none.
    quarter_turns: int = 0
    # Why the answer is less than was requested, how the file was read, or by which tags; else empty.
    note: str = ""
    # Whether it is by printed tags, whose ids leave no doubt: no other photo or prior changes it.
    by_tags: bool = False

    @property
    def abstained(self) -> bool:
        """True when the answer is "not on this map": no hypothesis, or off-map more probable than each."""
        best = self.hypotheses[0].probability if self.hypotheses else None
        return is_off_map(best, self.off_map_probability)


def is_off_map(best: float | None, off: float | None) -> bool:
    """Decide whether an answer says "not on this map".

    Args:
        best: Probability of its first hypothesis; None without one.
        off: Probability that the photo was not taken on this map; None if unknown.
    """
    return best is None or (off is not None and off > best)


@dataclass(frozen=True, slots=True)
class AnswerSource:
    """Map and method that an answer comes from."""

    # `method`, `features`: Values of `--method` and `--features`, the latter resolved.
    method: str
    features: str
    georeference: Georeference | None  # Of the map
    map_revision: int
    map_kind: MapKind = "metric"  # Kind of the map
    place_radius_px: float | None = None  # Distance within which a hypothesis counts as right
    sequence: bool = False  # Whether the photo was one of a sequence, whose earlier photos count, too
    floors: tuple[Floor, ...] = ()  # Floors of the map
