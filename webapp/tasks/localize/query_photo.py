"""Reads a query once for all looks: a photo, or a panorama cut into level views."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.bars import Inside, inside_bars
from webapp.core.features.global_descriptor import GlobalDescriptor
from webapp.core.geometry.equirectangular import ViewSize, cut_view, panorama_pixels, panorama_size, view_size
from webapp.core.geometry.tilt import Tilt
from webapp.core.hypotheses.model import Answer, Evidence, FieldOfView, Hypothesis
from webapp.core.mapmodel.panorama import FOCAL_35MM, VIEWS, experience_of
from webapp.core.retrieval.fields_of_view import cropped_fov_deg, guessed_fov_deg
from webapp.files.decode import contrast_note
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import GrayPhoto, PhotoFacts, read_facts, read_gray, read_upright, scaled_gray
from webapp.settings import Settings
from webapp.tasks.localize.open_map import OpenMap


@dataclass(frozen=True, slots=True)
class PanoramaView:
    """A level view of a query panorama."""

    size: ViewSize
    panorama: tuple[int, int]  # Width and height of the panorama, pixels
    turn_deg: float  # Clockwise rotation of the view from the middle of the panorama
    tilt: Tilt  # Of the panorama

    def to_panorama(self, answer: Answer) -> Answer:
        """Convert the view's answer to the panorama: heading of its middle, and matches in its pixels."""
        whole = None if answer.fov is None else FieldOfView(360.0, answer.fov.source)
        hypotheses = tuple(self._of_middle(h) for h in answer.hypotheses)
        evidence = tuple(self._on_panorama(e) for e in answer.evidence)
        return replace(answer, hypotheses=hypotheses, evidence=evidence, fov=whole, quarter_turns=0)

    def _of_middle(self, hypothesis: Hypothesis) -> Hypothesis:
        if hypothesis.heading_deg is None:
            return hypothesis
        return replace(hypothesis, heading_deg=math.remainder(hypothesis.heading_deg - self.turn_deg, 360.0))

    def _on_panorama(self, evidence: Evidence) -> Evidence:
        xy = evidence.query_xy.astype(np.float64)
        at, _ = panorama_pixels(xy, self.size, panorama=self.panorama, turn_deg=self.turn_deg, tilt=self.tilt)
        return replace(evidence, query_xy=at.astype(np.float32))


def to_experiences(answer: Answer, opened: OpenMap) -> Answer:
    """Replace views of the map's panoramas in an answer by the panoramas, with matches in their pixels."""
    if not opened.views:
        return answer
    hypotheses = tuple(
        replace(h, experiences=tuple(dict.fromkeys(experience_of(id) for id in h.experiences)))
        for h in answer.hypotheses
    )
    best: dict[int, Evidence] = {}
    for one in answer.evidence:  # sorted, best first
        best.setdefault(experience_of(one.experience), one)
    evidence = tuple(_of_experience(one, opened) for one in best.values())
    return replace(answer, hypotheses=hypotheses, evidence=evidence)


def _of_experience(evidence: Evidence, opened: OpenMap) -> Evidence:
    view = opened.views.get(evidence.experience)
    if view is None:
        return evidence
    number = np.flatnonzero(opened.indexed.ids == evidence.experience)[0]
    size = ViewSize(*opened.indexed.photo_size(int(number)), FOCAL_35MM)
    whole = panorama_size(size.width, FOCAL_35MM)
    xy = evidence.photo_xy.astype(np.float64)
    at, _ = panorama_pixels(xy, size, panorama=whole, turn_deg=view.turn_deg, tilt=view.tilt)
    return replace(evidence, experience=experience_of(evidence.experience), photo_xy=at.astype(np.float32))


def pictures_of(experiences: Collection[int], opened: OpenMap) -> frozenset[int]:
    """Return the ids of the indexed pictures of some experiences: photos, or views of panoramas."""
    wanted = {experience_of(id) for id in experiences}
    if not opened.views:
        return frozenset(wanted)
    return frozenset(e.id for e in opened.pictures if experience_of(e.id) in wanted)


@dataclass(frozen=True, slots=True, eq=False)
class QueryPhoto:
    """A query, or a view of one."""

    gray: GrayPhoto
    fov: FieldOfView
    vector: NDArray[np.float32] | None  # (d,) float32 or None. Its global descriptor.
    seconds: float  # Time to read it
    view: PanoramaView | None = None  # Set for a view of a panorama
    # First pixel (x, y) of the photo in the upright file, whose uniform bars are cut off.
    origin: tuple[int, int] = (0, 0)
    note: str = ""  # How its file was read, if that is unusual
    file_size: tuple[int, int] = (0, 0)  # Width and height of the upright file, with bars, pixels

    def turned(self, quarters: int) -> QueryPhoto:
        """Rotate it clockwise by quarter turns, for features that are not rotation-invariant."""
        gray, fov = self.gray.turned(quarters), self.fov
        if quarters % 2:
            width, height = self.gray.full_size
            half = math.tan(math.radians(fov.degrees) / 2.0) * height / width
            fov = replace(fov, degrees=math.degrees(2.0 * math.atan(half)))
        return replace(self, gray=gray, fov=fov)

    def on_file(self, answer: Answer) -> Answer:
        """Convert an answer from pixels of this photo to those of its file with the bars; add its note."""
        if self.note and not answer.note:
            answer = replace(answer, note=self.note)
        if self.origin == (0, 0):
            return answer
        shift = np.array(self.origin, np.float32)
        evidence = tuple(replace(e, query_xy=e.query_xy + shift) for e in answer.evidence)
        return replace(answer, evidence=evidence)

    def turned_back(self, answer: Answer, *, quarters: int) -> Answer:
        """Convert an answer about this rotated photo (`turned`) to pixels of the original photo."""
        evidence = tuple(
            replace(e, query_xy=_turned_back(e.query_xy, self.gray.full_size, quarters))
            for e in answer.evidence
        )
        return replace(answer, evidence=evidence, quarter_turns=quarters)


def _turned_back(xy: NDArray[np.float32], size: tuple[int, int], quarters: int) -> NDArray[np.float32]:
    """Rotate pixels of a photo of this size counterclockwise; pixel centres have integer coordinates."""
    width, height = size
    for _ in range(quarters):
        xy = np.column_stack([xy[:, 1], width - 1 - xy[:, 0]])
        width, height = height, width
    return xy


def read_query(
    path: Path, *, settings: Settings, fov_deg: float | None, describe: GlobalDescriptor | None
) -> list[QueryPhoto]:
    """Read a photo; a panorama with the metadata of one is cut into views. Raises PhotoError.

    Args:
        fov_deg: Horizontal field of view of a photo, with its bars, instead of the one in its EXIF.
        describe: Computes the global descriptor.
    """
    started = time.perf_counter()
    limits = settings.photo
    facts = read_facts(path, limits=limits)
    around = find_panorama(path, facts, limits=limits)
    if around is not None:
        return [*_views(path, around.tilt, settings=settings, describe=describe)]
    gray = read_gray(path, limits=limits, max_side=settings.extract.max_side_px)
    size = gray.full_size
    # A camera that states its field of view makes no bars.
    inside = None if facts.fov_deg is not None else _inside_bars(gray)
    if inside is not None:
        share = (inside.right - inside.left) / size[0]
        fov_deg = None if fov_deg is None else cropped_fov_deg(fov_deg, share)
        full = read_gray(path, limits=limits).pixels[inside.top : inside.bottom, inside.left : inside.right]
        gray = scaled_gray(np.ascontiguousarray(full), settings.extract.max_side_px)
    vector = None
    if describe is not None:
        colours = read_upright(path, limits=limits)
        if inside is not None:
            colours = colours[inside.top : inside.bottom, inside.left : inside.right]
        vector = describe.describe(np.ascontiguousarray(colours))
    fov = _field_of_view(facts, gray, given=fov_deg)
    origin = (0, 0) if inside is None else (inside.left, inside.top)
    note = contrast_note(path, limits=limits) or ""
    seconds = time.perf_counter() - started
    return [QueryPhoto(gray, fov, vector, seconds, origin=origin, note=note, file_size=size)]


def _inside_bars(gray: GrayPhoto) -> Inside | None:
    """Find the photo inside uniform bars, pixels of the full-size photo; None if there are no bars."""
    height, width = gray.pixels.shape
    found = inside_bars(gray.pixels)
    if found == Inside(0, 0, width, height):
        return None
    full_width, full_height = gray.full_size
    return Inside(
        math.ceil(found.left / gray.scale),
        math.ceil(found.top / gray.scale),
        full_width if found.right == width else int(found.right / gray.scale),
        full_height if found.bottom == height else int(found.bottom / gray.scale),
    )


def _field_of_view(facts: PhotoFacts, gray: GrayPhoto, *, given: float | None) -> FieldOfView:
    if given is not None:
        return FieldOfView(given, "option")
    if facts.fov_deg is not None:
        return FieldOfView(facts.fov_deg, "exif")
    return FieldOfView(guessed_fov_deg(*gray.full_size), "guess")


def _views(
    path: Path, tilt: Tilt, *, settings: Settings, describe: GlobalDescriptor | None
) -> Iterator[QueryPhoto]:
    started = time.perf_counter()
    pixels = read_upright(path, limits=settings.photo)
    height, width = pixels.shape[:2]
    size = view_size(width, FOCAL_35MM)
    fov = FieldOfView(size.camera.fov_deg, "exif")
    for number in range(VIEWS):
        turn_deg = 360.0 * number / VIEWS
        cut, _ = cut_view(pixels, size, turn_deg=turn_deg, tilt=tilt)
        gray = np.asarray(cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY), np.uint8)
        vector = None if describe is None else describe.describe(cut)
        view = PanoramaView(size, (width, height), turn_deg, tilt)
        small = scaled_gray(gray, settings.extract.max_side_px)
        yield QueryPhoto(small, fov, vector, time.perf_counter() - started, view)
        started = time.perf_counter()
