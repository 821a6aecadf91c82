"""Parameters of localization, in one frozen value that is passed down from the top.

Except for the length of the shortlist they are not user settings, and changing one requires a new
calibration. They are collected here for an overview and to be varied (`benchmarks/ablation.py`). Lengths that
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
    """Photos with most votes that a network matches first, in the second look of method `auto`."""

    certain_inliers: int = 40
    """Inliers from which on one of these certainly shows the same scene as the query. With fewer, the network
    matches the rest of the shortlist, too."""

    voters: int = 30
    """Photos with most votes, whose votes support the places around them."""

    similar: int = 4
    """Photos of the shortlist that are chosen by similarity of global descriptors, if there are any: at most
    half of it."""

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
    """Standard deviation of a right match, pixels of the photo as extracted. It covers the noise of the
    keypoint and the error of the map photo's rotation."""

    min_depth: float = 0.05
    """Minimum depth of a matched point, place radii. A short baseline then explains only small angles between
    rays; without this limit every match would agree with a pose at baseline zero."""

    start_distances: tuple[float, ...] = (0.15, 0.5, 1.0, 2.0)
    """Starting points on the line through a photo, place radii from it."""

    min_trust: float = 0.15
    """Minimum trust in a relative pose that gives starting points, 0 to 1."""

    starts: int = 4
    """Best starting points that are refined."""

    starts_apart: float = 0.3
    """Starting points nearer to each other than this, place radii, are one."""

    inlier_sigmas: float = 1.25
    """Residual from which on a match is not an inlier, sigmas."""

    start_inlier_sigmas: float = 3.75
    """The same for starting points, whose poses are still rough."""

    reach: float = 3.0
    """Scale of the decay of a photo's weight with its distance, place radii."""

    chance_inliers: float = 2.0
    """Inliers of a photo that any pose has by chance."""

    inlier_scale: float = 20.0
    """Inliers beyond chance at which a photo's agreement reaches 63 %."""

    roll_deg: float = 6.0
    """Roll at which the score of a pose is halved, degrees."""

    annealing: Annealing = Annealing(rounds=10, start=15.0, decay=0.65)
    """Wide at first and shrinking fast: starting poses are off by a large part of a place radius."""

    level: LevelPrior = LevelPrior(roll_sigma=0.035, pitch_sigma=0.35)
    """Wide in pitch: queries may look up or down, but their roll is corrected beforehand by keypoints."""

    height_sigma: float = 0.3
    """Standard deviation of the query's height about that of the map's cameras, place radii."""

    max_rotation_step: float = 0.2
    """Longest step of an iteration, radians."""

    max_translation_step: float = 0.7
    """Longest step of an iteration, place radii."""


@dataclass(frozen=True, slots=True)
class PlacesTuning:
    """Places with uncertainties from poses and votes."""

    most: int = 8
    """Maximum number of places, or half of the shortlist if that is more."""

    min_weight: float = 0.02
    """Minimum trust in a relative pose whose bearing is used, 0 to 1."""

    support_reaches: tuple[float, float] = (0.5, 2.0)
    """Standard deviations of the windows in which votes support a place, close to it and in its surroundings;
    place radii."""
    apart: float = 1.0
    """Places nearer to each other than this, place radii, are one: only the better one is kept."""
    anchor_reach: float = 3.0
    """Photos farther from a computed position than this, place radii, are not combined with it."""
    min_agreement: float = 0.25
    """Minimum agreement of a photo that supports a place, 0 to 1."""

    score_sigma: float = 0.3
    """Uncertainty at a score of zero, times `score_offset`, place radii."""

    score_offset: float = 0.3
    """Added to the score, which counts photos, in the denominator of that uncertainty."""

    correlation: float = 6.0
    """Factor on the standard deviation from the matches, because their errors are correlated."""

    floor_sigma: float = 0.27
    """Minimum uncertainty of a position, place radii: the map's own positions are not better."""

    photo_place_sigma: float = 0.6
    """Uncertainty of a photo's position as the answer, place radii: two of three right ones are that near."""

    max_sigma: float = 1.0
    """Uncertainty from the matches above which no position is given, place radii: a single photo without
    depths fixes only a line."""


@dataclass(frozen=True, slots=True)
class CropsTuning:
    """Queries of unknown field of view that may be crops."""

    shares: tuple[float, ...] = (0.7, 0.5)
    """Shares of the width of a whole photo that a crop may show."""

    prior: float = 0.2
    """Prior probability of each of them."""

    power: float = 2.0
    """Power of the odds by which fields of view are weighted. Odds are calibrated for places, which share
    their votes whatever the field of view; of that the geometry says more."""

    min_odds: float = 100.0
    """Minimum of the largest odds: smaller ones differ by chance, and the photo is taken for a whole one."""


@dataclass(frozen=True, slots=True)
class ExtrinsicsTuning:
    """Rotations and heights of the map's photos, and depths of their keypoints."""

    keypoint_sigma_px: float = 1.2
    """Standard deviation of a keypoint, pixels of the photo as extracted."""

    matches_per_pair: int = 40
    """Matches of a pair, evenly chosen, that refine rotations: more are redundant. Depths use all."""

    depth_inlier_sigmas: float = 2.0
    """Sampson error, sigmas, from which on a match gives no depth: its rays do not meet."""

    min_angle_deg: float = 1.0
    """Minimum angle between two rays that give a depth, degrees."""

    certain_inliers: int = 40
    """Inliers from which on two photos certainly show the same scene."""

    position_sigma: float = 0.1
    """Sigma of a photo's position on the map, place radii: relative to the baseline, the error of depths."""

    averaging: Annealing = Annealing(rounds=60, start=4.0, decay=0.9)
    """Rotation averaging: many slow rounds, because headings from votes can be arbitrarily wrong."""

    averaging_level: LevelPrior = LevelPrior(roll_sigma=0.04, pitch_sigma=0.2, weight=0.3)
    """Directions hardly constrain pitch: the prior is tighter here than in the refinement."""

    refinement: Annealing = Annealing(rounds=30, start=8.0, decay=0.85)
    """Refinement by all matches: it starts within a few degrees."""

    refinement_level: LevelPrior = LevelPrior(roll_sigma=0.03, pitch_sigma=0.3)
    """All matches together determine pitch well, so that the prior may be wide."""

    height_sigma: float = 0.2
    """Standard deviation of the cameras' heights, place radii."""


@dataclass(frozen=True, slots=True)
class Tuning:
    """All parameters of localization, by stage."""

    retrieval: RetrievalTuning = field(default_factory=RetrievalTuning)
    pose: PoseTuning = field(default_factory=PoseTuning)
    places: PlacesTuning = field(default_factory=PlacesTuning)
    crops: CropsTuning = field(default_factory=CropsTuning)
    extrinsics: ExtrinsicsTuning = field(default_factory=ExtrinsicsTuning)


DEFAULT = Tuning()

_Value = TypeVar("_Value")


def with_field(tuning: _Value, name: str, *, text: str) -> _Value:
    """Set one field.

    Args:
        name: Dotted, e.g. `pose.level.roll_sigma`.
        text: The number; it is converted to the type of the field.

    Raises:
        KeyError: A field is unknown or not numeric; the known fields are listed.
        ValueError: The text is not a number of the field's type.
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
