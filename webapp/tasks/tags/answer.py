"""Localizes a photo by the printed tags of a map that it shows; no photo of the map is needed."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import Camera
from webapp.core.hypotheses.model import (
    Answer,
    CameraPose,
    FieldOfView,
    Hypothesis,
    MatchStatistics,
)
from webapp.core.hypotheses.priors import relative_to_north
from webapp.core.landmarks.absolute_pose import Lens, angle_jacobian, euler_angles
from webapp.core.mapmodel.control_points import GroundControlPoint, tag_anchors
from webapp.core.mapmodel.model import Map
from webapp.core.retrieval.fields_of_view import guessed_fov_deg
from webapp.core.tags.detect import SeenTag, find_tags
from webapp.core.tags.pose import PlacedTag, SolvedByTags, TagPose, distance_to, solve_by_tags
from webapp.files.contents import local
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import read_facts, read_gray
from webapp.settings import Settings

_MAX_SIDE_PX = 4096
"""Photos are searched for tags at this size."""

_HEIGHT_SIGMA_M, _UNKNOWN_HEIGHT_SIGMA_M = 0.05, 1.0
_CLICK_PX = 1.0
"""Standard deviation of the position of a tag without a stated accuracy, map pixels."""

_MOST_TAGS = 12
_OFF_MAP, _OFF_MAP_CONTRADICTED = 0.01, 0.1
"""Probability that tags mislead: one has been moved, or copied."""

_RELIABLE = ("36h11", "5x5_100", "6x6_250")
"""Families of which a tag is hardly ever read by chance."""

_MOST_NAMED = 4


@dataclass(frozen=True, slots=True)
class TagAnswer:
    """The answer by tags; None if they give none, and then why, if the photo shows any."""

    answer: Answer | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class _Query:
    tags: tuple[SeenTag, ...]
    lens: Lens
    fov: FieldOfView


def has_tags(the_map: Map) -> bool:
    """Return whether a map has tags with a position."""
    return bool(tag_anchors(the_map.control_points))


def answer_by_tags(
    path: Path, the_map: Map, *, settings: Settings, fov_deg: float | None = None
) -> TagAnswer:
    """Localize a photo by the tags that it shows.

    Args:
        fov_deg: Horizontal field of view, instead of the one in its EXIF.

    Raises:
        PhotoError: The photo cannot be read.
    """
    if not has_tags(the_map):
        return TagAnswer()
    started = time.perf_counter()
    query = _read(local(path), the_map, settings=settings, fov_deg=fov_deg)
    if query is None or not query.tags:
        return TagAnswer()
    if the_map.georeference is None:
        return TagAnswer(None, "tags are used only on a map with a georeference, which says how large it is")
    found = _solve(query, the_map, the_map.georeference)
    if found.answer is None:
        return found
    answer = relative_to_north(found.answer, the_map.georeference)
    seconds = {"read": 0.0, "total": time.perf_counter() - started}
    return replace(found, answer=replace(answer, fov=query.fov, seconds=seconds, note=found.note))


def nothing_by_tags(note: str) -> Answer:
    """Return the answer about a photo on a map of tags alone that gives no place."""
    reason = note or "no tag of the map is in sight"
    return Answer((), None, 0.0, NoPose(reason, blank=True), _STATISTICS, by_tags=True)


_STATISTICS = MatchStatistics(0, 0, 0, None, None, None, None)


def _read(path: Path, the_map: Map, *, settings: Settings, fov_deg: float | None) -> _Query | None:
    """Find tags in a photo; None for a panorama."""
    facts = read_facts(path, limits=settings.photo)
    if find_panorama(path, facts, limits=settings.photo) is not None:
        return None
    gray = read_gray(path, limits=settings.photo, max_side=_MAX_SIDE_PX)
    families = {point.tag.family for point in the_map.control_points if point.tag is not None}
    seen = find_tags(gray.pixels, families) or find_tags(gray.pixels, {*_RELIABLE} - families)
    tags = tuple(tag._replace(corners=(tag.corners + 0.5) / gray.scale - 0.5) for tag in seen)
    if fov_deg is not None:
        fov = FieldOfView(fov_deg, "option")
    elif facts.fov_deg is not None:
        fov = FieldOfView(facts.fov_deg, "exif")
    else:
        fov = FieldOfView(guessed_fov_deg(*gray.full_size), "guess")
    focal_px = Camera(*gray.full_size, fov.degrees).focal_px
    return _Query(tags, Lens(*gray.full_size, focal_px, focal_sigma=fov.focal_sigma), fov)


_Placing = list[tuple[SeenTag, GroundControlPoint]]
_Points = Mapping[tuple[str, int], Sequence[GroundControlPoint]]


def _solve(query: _Query, the_map: Map, georeference: Georeference) -> TagAnswer:
    notes: list[str] = []
    points = _points_of(the_map)
    checks = {
        (point.tag.family, point.tag.number)
        for point in the_map.control_points
        if point.tag and point.is_check
    } - points.keys()
    shown = [(tag.family, tag.number) for tag in query.tags]
    if checked := _titles(checks.intersection(shown)):
        notes.append(f"the photo shows {_listed(checked)}, at check points, by which no photo is localized")
    tags = [tag for tag, key in zip(query.tags, shown, strict=True) if key not in checks]
    placings = _placings(tags, points, notes)
    found: list[Hypothesis] = []
    off_map = _OFF_MAP
    for placing in placings:
        frame = _Frame.of(placing, the_map, georeference)
        placed = [frame.placed(tag, point) for tag, point in placing]
        share = 1.0 / len(placings)
        solved = solve_by_tags(placed, lens=query.lens)
        if isinstance(solved, SolvedByTags):
            notes.append("by " + _listed(solved.poses[0].tags))
            found += [frame.hypothesis(pose, share=share) for pose in solved.poses]
            if solved.contradicting:
                off_map = _OFF_MAP_CONTRADICTED
                notes.append(f"contradicted by {_listed(solved.contradicting)}: was one moved?")
            continue
        notes.append(solved.reason)
        if len(placed) == 1:
            apart_m = distance_to(placed[0], lens=query.lens) * (1.0 + query.lens.focal_sigma)
            found.append(frame.ring(placed[0], apart_m, share=share))
    note = "; ".join(dict.fromkeys(notes))
    if not found:
        return TagAnswer(None, note)
    found.sort(key=lambda one: -one.probability)
    ranked = tuple(
        replace(one, rank=rank, probability=one.probability * (1.0 - off_map))
        for rank, one in enumerate(found, 1)
    )
    return TagAnswer(Answer(ranked, off_map, 0.0, None, _STATISTICS, by_tags=True), note)


def _points_of(the_map: Map) -> _Points:
    points: dict[tuple[str, int], list[GroundControlPoint]] = {}
    for point in tag_anchors(the_map.control_points):
        if point.tag is not None:
            points.setdefault((point.tag.family, point.tag.number), []).append(point)
    return points


def _placings(tags: Sequence[SeenTag], points: _Points, notes: list[str]) -> list[_Placing]:
    """Return where on the map the tags of a photo may be: one choice, or several of a tag that is ambiguous.

    Args:
        notes: What is said of tags that do not count is added.
    """
    seen = [(tag.family, tag.number) for tag in tags]
    there = [
        (tag, points[key])
        for tag, key in zip(tags, seen, strict=True)
        if key in points and seen.count(key) == 1
    ]
    unknown = _titles(key for key in seen if key not in points)
    twice = _titles(key for key in seen if key in points and seen.count(key) > 1)
    several = _titles((tag.family, tag.number) for tag, those in there if len(those) > 1)
    if unknown:
        notes.append(f"the photo shows {_listed(unknown)}, which the map does not have")
    if twice:
        notes.append(f"the photo shows {_listed(twice)} more than once, which does not count")
    if several:
        notes.append(f"the map has {_listed(several)} at several places")
    unique = [(tag, those[0]) for tag, those in there if len(those) == 1]
    if unique or not there:
        return [unique[:_MOST_TAGS]] if unique else []
    tag, those = there[0]
    return [[(tag, point)] for point in those]


def _titles(keys: Iterable[tuple[str, int]]) -> list[str]:
    return [f"{family} {number}" for family, number in sorted({*keys})]


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMED
    shown = ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"the {'tag' if len(names) == 1 else 'tags'} {shown}"


@dataclass(frozen=True, slots=True)
class _Frame:
    """Metres on the map around a tag: x right and y down from the corner of the map, z down."""

    georeference: Georeference
    scale: float  # Metres per pixel
    level_m: float  # Height that stands for those that are not known

    @classmethod
    def of(cls, placing: _Placing, the_map: Map, georeference: Georeference) -> _Frame:
        points = tag_anchors(the_map.control_points)
        heights = [point.height_m for point in points if point.height_m is not None]
        at = placing[0][1].position
        scale = math.nan if at is None else georeference.metres_per_pixel(at)
        return cls(georeference, scale, float(np.mean(heights)) if heights else 0.0)

    def placed(self, seen: SeenTag, point: GroundControlPoint) -> PlacedTag:
        at, tag, height = point.position, point.tag, point.height_m
        if at is None or tag is None:
            raise ValueError(f"{point.name} has no tag, or is not on the map")
        sigma = _CLICK_PX * self.scale if point.accuracy_m is None else point.accuracy_m
        height_sigma = _UNKNOWN_HEIGHT_SIGMA_M if height is None else _HEIGHT_SIGMA_M
        north = self.georeference.north_deg(at)
        return PlacedTag(
            tag.title,
            seen.corners,
            tag.size_mm / 1000.0,
            np.array([at.x * self.scale, at.y * self.scale, -(self.level_m if height is None else height)]),
            np.array([sigma, sigma, height_sigma]),
            tag.mount,
            None if tag.heading_deg is None else math.radians(tag.heading_deg + north),
        )

    def hypothesis(self, pose: TagPose, *, share: float) -> Hypothesis:
        heading, pitch, roll = np.degrees(euler_angles(pose.rotation)).tolist()
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = np.diag([1.0, 1.0, -1.0]) / self.scale
        jacobian[3:, 3:] = np.degrees(angle_jacobian(pose.rotation))
        covariance = jacobian @ pose.covariance @ jacobian.T
        x, y, z = (float(value) / self.scale for value in pose.centre)
        corners = 4 * len(pose.tags)
        return Hypothesis(
            rank=0,
            kind="position",
            position=MapPixel(x, y),
            probability=share * pose.weight,
            radius_px=pose.radius_m / self.scale,
            heading_deg=heading % 360.0,
            experiences=(),
            inliers=corners,
            matches=corners,
            camera=CameraPose(-z, pitch, roll, covariance, corners),
        )

    def ring(self, tag: PlacedTag, apart_m: float, *, share: float) -> Hypothesis:
        """Return the place of a tag with the distance from it as radius, as the direction is not known."""
        at = MapPixel(float(tag.at[0]) / self.scale, float(tag.at[1]) / self.scale)
        radius = apart_m / self.scale
        return Hypothesis(0, "position", at, share, radius, None, (), 4, 4)
