"""The numbers that steer localization, in one frozen value that is passed in from the top.

All but the length of the shortlist are no settings: nobody has to choose them, and changing one calls for a
new calibration. They are here to be read together, and to be varied (`benchmarks/ablation.py`). Lengths that
scale with the map are in place radii, the distance within which an answer counts as right.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

from webapp.core.geometry.level_camera import LevelPrior
from webapp.core.geometry.robust import Annealing


@dataclass(frozen=True, slots=True)
class RetrievalTuning:
    """Votes and the shortlist."""

    neighbours: int = 10
    """Nearest map descriptors of each query descriptor that vote."""

    shortlist: int = 12
    """Photos with most votes that are verified geometrically."""

    second_look_photos: int = 5
    """Photos with most votes that a network matches first in the second look of method `auto`."""

    certain_inliers: int = 40
    """Inliers from which on one of these certainly shows the same as the query. With fewer, the network
    matches the rest of the shortlist, too."""

    voters: int = 30
    """Photos with most votes whose votes count for the places around them."""

    similar: int = 4
    """Photos of the shortlist that are there for being the most similar by their global descriptors, where
    there are such: at most half of it."""

    rotation_tolerance_deg: float = 20.0
    """Largest deviation of a match from the dominant rotation between query and map, degrees."""

    pair_neighbours: int = 11
    """Nearest descriptors that vote when the map's photos are matched with each other."""

    pair_shortlist: int = 12
    """Photos that each photo of the map is matched with."""


@dataclass(frozen=True, slots=True)
class PoseTuning:
    """Refinement of the query's pose by all matches."""

    keypoint_sigma_px: float = 2.4
    """Standard deviation of a right match, pixels of the photo as extracted. It stands for the keypoint and
    for the error of the map photo's rotation."""

    min_depth: float = 0.05
    """Nearest point that a match can show, place radii. A short baseline then explains small angles between
    rays only: without it, at baseline zero, every match agrees with every pose."""

    start_distances: tuple[float, ...] = (0.15, 0.5, 1.0, 2.0)
    """Starting points on the line through a photo, place radii from it."""

    min_trust: float = 0.15
    """Trust in a relative pose from which on it gives starting points, 0 to 1."""

    starts: int = 4
    """Best starting points that are refined."""

    starts_apart: float = 0.3
    """Starting points nearer to each other than this, place radii, are one."""

    inlier_sigmas: float = 1.25
    """Residual at which a match stops counting as an inlier, sigmas."""

    start_inlier_sigmas: float = 3.75
    """The same for starting points, whose poses are still rough."""

    reach: float = 3.0
    """How fast a photo's weight decays with its distance, place radii."""

    chance_inliers: float = 2.0
    """Inliers of a photo that any pose has."""

    inlier_scale: float = 20.0
    """Inliers beyond chance at which a photo's agreement reaches 63 %."""

    roll_deg: float = 6.0
    """Roll at which the score of a pose is halved, degrees."""

    annealing: Annealing = Annealing(rounds=10, start=15.0, decay=0.65)
    """Starting poses are off by a good part of a place radius: wide at first, and shrinking fast."""

    level: LevelPrior = LevelPrior(roll_sigma=0.035, pitch_sigma=0.35)
    """Queries are levelled by their keypoints, whatever their roll was; they may look up and down."""

    height_sigma: float = 0.3
    """Of the query's height about that of the map's cameras, place radii."""

    max_rotation_step: float = 0.2
    """Longest step of an iteration, radians."""

    max_translation_step: float = 0.7
    """Longest step of an iteration, place radii."""


@dataclass(frozen=True, slots=True)
class PlacesTuning:
    """From poses and votes to places with an uncertainty."""

    most: int = 8
    """Places, or half of the shortlist where that is more."""

    min_weight: float = 0.02
    """Trust in a relative pose from which on its bearing is used, 0 to 1."""

    support_reaches: tuple[float, float] = (0.5, 2.0)
    """Standard deviations of the windows in which votes count for a place: close to it, and its surroundings,
    place radii."""
    apart: float = 1.0
    """Places nearer to each other than this, place radii, are one: the better one stands for both."""
    anchor_reach: float = 3.0
    """Photos farther from a computed position than this, place radii, do not say where it is."""
    min_agreement: float = 0.25
    """Agreement from which on a photo supports a place, 0 to 1."""

    score_sigma: float = 0.3
    """Uncertainty by a score of zero is this over `score_offset`, place radii."""

    score_offset: float = 0.3
    """Added to the score, which counts photos, under that uncertainty."""

    correlation: float = 6.0
    """Factor on the standard deviation by the matches, because their errors are correlated."""

    floor_sigma: float = 0.27
    """Uncertainty of the best position, place radii: the map's own positions are not better."""

    photo_place_sigma: float = 0.6
    """Uncertainty of a place that is a photo's own, place radii: two of three right ones are so near."""

    max_sigma: float = 1.0
    """Uncertainty by the matches above which there is no position, place radii: one photo whose depths are
    not known leaves a line."""


@dataclass(frozen=True, slots=True)
class ExtrinsicsTuning:
    """Rotations and heights of the map's photos, and depths of their keypoints."""

    keypoint_sigma_px: float = 1.2
    """Standard deviation of a keypoint, pixels of the photo as extracted."""

    matches_per_pair: int = 40
    """Matches of a pair, evenly chosen, that correct rotations: more say the same again. Depths use all."""

    depth_inlier_sigmas: float = 2.0
    """Rays that are farther from meeting than this, sigmas of a keypoint, give no depth."""

    min_angle_deg: float = 1.0
    """Least angle between two rays that give a depth, degrees."""

    certain_inliers: int = 40
    """Inliers from which on two photos certainly show the same."""

    position_sigma: float = 0.1
    """Of a photo on the map, place radii: all depths of a pair err by it over the baseline."""

    averaging: Annealing = Annealing(rounds=60, start=4.0, decay=0.9)
    """Rotation averaging: the start is a vote that can be wrong by anything, many slow rounds."""

    averaging_level: LevelPrior = LevelPrior(roll_sigma=0.04, pitch_sigma=0.2, weight=0.3)
    """Directions say little of pitch: it is held closer here than when all matches count."""

    refinement: Annealing = Annealing(rounds=30, start=8.0, decay=0.85)
    """Refinement by all matches: the start is good to some degrees."""

    refinement_level: LevelPrior = LevelPrior(roll_sigma=0.03, pitch_sigma=0.3)
    """All matches measure pitch well, so that the prior may be wide."""

    height_sigma: float = 0.2
    """Of the cameras' heights, place radii."""


@dataclass(frozen=True, slots=True)
class Tuning:
    """Everything that steers localization, by stage."""

    retrieval: RetrievalTuning = field(default_factory=RetrievalTuning)
    pose: PoseTuning = field(default_factory=PoseTuning)
    places: PlacesTuning = field(default_factory=PlacesTuning)
    extrinsics: ExtrinsicsTuning = field(default_factory=ExtrinsicsTuning)


DEFAULT = Tuning()

_Value = TypeVar("_Value")


def with_field(tuning: _Value, name: str, *, text: str) -> _Value:
    """Set one field.

    Parameters
    ----------
    tuning : Tuning
        Or a part of it.
    name : str
        Dotted, as `pose.level.roll_sigma`.
    text : str
        The number; it is converted to the type of the field.

    Raises
    ------
    KeyError
        A field is unknown, or its value is not a number; the known fields are listed.
    ValueError
        The text is not a number of the field's type.
    """
    first, _, rest = name.partition(".")
    value = getattr(tuning, first, None)
    if rest and is_dataclass(value):
        changed: Any = with_field(value, rest, text=text)
    elif not rest and isinstance(value, int | float):
        changed = type(value)(text)
    else:
        raise KeyError(f"no field {name!r}; known: {', '.join(field_names(tuning))}")
    return replace(tuning, **{first: changed})  # type: ignore[type-var]


def field_names(tuning: object) -> Iterator[str]:
    """Yield the dotted names of all numbers."""
    for each in fields(tuning):  # type: ignore[arg-type]
        value = getattr(tuning, each.name)
        if is_dataclass(value):
            yield from (f"{each.name}.{name}" for name in field_names(value))
        elif isinstance(value, int | float):
            yield each.name
