"""The localization of one photo, stage by stage.

1. read: decode the photo upright and downscaled, read its field of view and, where a model is installed,
   compute its global descriptor; cut a panorama into views, each of which passes through the following
   stages (`query_photo`);
2. extract: keypoints and descriptors (`core.features`);
3. retrieve, verify, position: matching map photos, relative poses, positions (`core.localize`);
4. calibrate: evidence becomes probabilities (`core.hypotheses.calibration`);
5. prior: queries are likely near the map's photos and on the paths between them
   (`core.hypotheses.priors`).

A *look* is stages 2 to 4 with one kind of features. If the answer of the first look is uncertain, method
`auto` takes a second one, and combines both (`core.hypotheses.looks`).

`observe` stops before the prior: several photos of one spot (`spot.py`) and the frames of a sequence
(`sequence.py`) are combined first and have their own priors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from webapp.core.features.blank import FEW_KEYPOINTS, lacks_fine_detail, why_blank, why_too_few
from webapp.core.features.extract import extract
from webapp.core.features.table import Method
from webapp.core.features.types import Features
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses import joint, looks
from webapp.core.hypotheses.bayes import truncate
from webapp.core.hypotheses.calibration import DEFAULT, Calibration
from webapp.core.hypotheses.crops import average_answers
from webapp.core.hypotheses.map_accuracy import limit_accuracy
from webapp.core.hypotheses.model import Answer, AnswerSource, FieldOfView
from webapp.core.hypotheses.places import MapKind
from webapp.core.hypotheses.priors import apply_path_prior_to_answer, relative_to_north
from webapp.core.localize import vote
from webapp.core.localize.landmarks import find_by_landmarks
from webapp.core.localize.verified import PlaceSearch, find_places_by_fov, with_probabilities
from webapp.core.localize.vote import match_statistics
from webapp.core.mapmodel.control_points import tag_anchors
from webapp.core.mapmodel.model import Map
from webapp.core.reconstruction.depths import DepthObservations, DepthsExcluding
from webapp.core.retrieval.fields_of_view import cropped_fov_deg
from webapp.errors import UsageError
from webapp.files.contents import local
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.localize.models import network
from webapp.settings import Settings
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.query_photo import QueryPhoto, pictures_of, read_query, to_experiences
from webapp.tasks.tags.answer import answer_by_tags, nothing_by_tags
from webapp.telemetry import span

_ALL = 100
"""Maximum number of hypotheses of a look, large enough to keep all."""

NOTHING: frozenset[int] = frozenset()

_BOTH = looks.DEFAULT


@dataclass(slots=True)
class _Stopwatch:
    """Seconds per stage and in total; reading the photo is timed before it starts."""

    seconds: dict[str, float]
    _begun: float = field(default_factory=time.perf_counter)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        before = time.perf_counter()
        with span(f"localize: {name}"):
            yield
        self.seconds[name] = time.perf_counter() - before

    def total(self) -> dict[str, float]:
        return {**self.seconds, "total": self.seconds["read"] + time.perf_counter() - self._begun}


class PoseRefinement(Protocol):
    """Refines an answer to a camera pose; see `LandmarksAround`."""

    def refine(
        self, answer: Answer, opened: OpenMap, *, query: Features, fov: FieldOfView, hide: Collection[int]
    ) -> Answer:
        """Refine the first hypothesis."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A map that is open for one look."""

    opened: OpenMap
    # None for a method without calibration, or before it is computed.
    calibration: StoredCalibration | None = None
    # Depth observations of the map's keypoints, to compute depths without the photos that are hidden. If
    # None, no depths are used when photos are hidden.
    sightings: DepthObservations | None = None
    # Solves the camera pose from landmarks made on demand, for a map without landmarks.
    around: PoseRefinement | None = None
    # Time it took to update the orientations of the photos, if they have been updated.
    orientation_seconds: float | None = None

    @property
    def features(self) -> str:
        """Name of the features."""
        return self.opened.choice.name

    def localize(self, photo: QueryPhoto, *, hide: frozenset[int], include: frozenset[int]) -> Answer:
        """Localize a photo by its content alone.

        Args:
            hide, include: Ids of pictures, see `LocalizationPipeline.observe`.
        """
        watch = _Stopwatch({"read": photo.seconds})
        with watch.stage("extract"):
            features = self.extract(photo)
        opened, indexed = self.opened, self.opened.indexed
        if blank := why_blank(photo.gray.pixels, features):
            return self._of_photo(_nothing_to_see(features, blank, fov=photo.fov), photo, watch)
        if opened.method == "vote":
            with watch.stage("retrieve"):
                answer = vote.localize(indexed, features, top=_ALL, hide=hide)
            return self._of_photo(to_experiences(answer, opened), photo, watch)
        if opened.landmarks is not None:
            fovs: tuple[float, ...] = (photo.fov.degrees,)
            found = [find_by_landmarks(indexed, features, fov=photo.fov, aligned=opened.landmarks, hide=hide)]
        else:
            fovs, depths = self._fields_of_view(photo), self._depths_without(hide) if hide else None
            found = find_places_by_fov(
                indexed, features, fov_deg=fovs, hide=hide, include=include, depths=depths
            )
        answer = self._answer(found, [replace(photo.fov, degrees=degrees) for degrees in fovs])
        if len(features) < FEW_KEYPOINTS and not any(place.inliers for place in answer.hypotheses):
            nothing = _nothing_to_see(features, why_too_few(features), fov=photo.fov)
            return self._of_photo(nothing, photo, watch)
        if self.around is not None:
            fov = answer.fov or photo.fov
            answer = self.around.refine(answer, opened, query=features, fov=fov, hide=hide)
        return self._of_photo(answer, photo, watch)

    def _fields_of_view(self, photo: QueryPhoto) -> tuple[float, ...]:
        """Return the horizontal fields of view that a photo may have: several only if it may be a crop.

        A photo of the size of the map's photos, with or without its bars, is a whole one, unless it lacks
        fine detail: digital zoom enlarges the middle of a photo to its full size.
        """
        whole, indexed = photo.fov.degrees, self.opened.indexed
        if photo.fov.source != "guess":
            return (whole,)
        has_size = any(indexed.has_size(*size) for size in (photo.file_size, photo.gray.full_size))
        if has_size and not lacks_fine_detail(photo.gray.pixels):
            return (whole,)
        return (whole, *(cropped_fov_deg(whole, share) for share in indexed.tuning.crops.shares))

    def _answer(self, found: Sequence[PlaceSearch], fovs: Sequence[FieldOfView]) -> Answer:
        """Add probabilities to the places found with each field of view, and average the answers."""
        opened, indexed = self.opened, self.opened.indexed
        calibration = self.calibration.calibration if self.calibration else DEFAULT
        first, *further = (
            replace(to_experiences(answer, opened), fov=fov)
            for answer, fov in zip(
                (with_probabilities(indexed, f, calibration=calibration, top=_ALL) for f in found),
                fovs,
                strict=True,
            )
        )
        if not further:
            return first
        radius = indexed.place_radius_px
        return average_answers((first, *further), tuning=indexed.tuning.crops, place_radius_px=radius)

    def _of_photo(self, answer: Answer, photo: QueryPhoto, watch: _Stopwatch) -> Answer:
        if photo.view is not None:
            answer = photo.view.to_panorama(answer)
        answer = relative_to_north(answer, self.opened.map.georeference)
        return replace(answer, seconds={**answer.seconds, **watch.total()}, looks=(self.features,))

    def join(self, answers: Sequence[Answer]) -> Answer:
        """Join the answers about the views of a panorama, which are photos of one spot; or return the one."""
        return joint.combine(answers, paths=self.opened.indexed.paths, top=_ALL)

    def extract(self, photo: QueryPhoto) -> Features:
        """Extract the features of this look."""
        choice, gray, settings = self.opened.choice, photo.gray, self.opened.settings
        features = extract(
            gray.pixels,
            choice,
            keypoints=settings.extract.keypoints,
            scale=gray.scale,
            photo_size=gray.full_size,
            network=network(choice.model, settings.models, weights=choice.weights),
        )
        return replace(features, vector=photo.vector)

    def _depths_without(self, hide: frozenset[int]) -> DepthsExcluding | None:
        if self.sightings is None:
            return None
        return DepthsExcluding(self.sightings, np.isin(self.opened.indexed.ids, [*hide]))


def _nothing_to_see(features: Features, reason: str, *, fov: FieldOfView) -> Answer:
    """Answer that says neither a place nor that the photo was not taken on the map."""
    counts = match_statistics(len(features), np.zeros(0, np.float32), left=0)
    return Answer((), None, 0.0, NoPose(f"nothing to recognise: {reason}", blank=True), counts, fov=fov)


@dataclass(frozen=True, slots=True, eq=False)
class TaggedMap:
    """A map of printed tags, without photos."""

    cfg: Path
    map: Map
    settings: Settings


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationPipeline:
    """A method on an open map."""

    method: Method  # The requested method
    looks: tuple[Look, ...]  # One or two; none on a map of tags alone
    both: Calibration = _BOTH  # Calibration of two looks combined
    fov_deg: float | None = None  # Horizontal field of view of the queries, instead of the one in their EXIF
    tags_alone: TaggedMap | None = None  # The map, if it has tags and no photos

    def localize(
        self,
        photo_path: Path,
        *,
        top: int,
        hide: frozenset[int] = NOTHING,
        on_first: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Localize one photo by all stages.

        Args:
            top: Maximum number of hypotheses.
            hide: Experience ids to leave out.
            on_first: Called with the answer of the first look, if a second one follows.

        Raises:
            PhotoError: The photo cannot be used.
        """

        def finish(answer: Answer) -> Answer:
            if answer.by_tags:
                return answer
            return self.limit_accuracy(apply_path_prior_to_answer(answer, self.opened.indexed.paths))

        report = None if on_first is None else lambda first: on_first(finish(first))
        return finish(self.observe(photo_path, top=top, hide=hide, on_first=report))

    def limit_accuracy(self, answer: Answer) -> Answer:
        """Enlarge the radii of a final answer to at least the accuracy of the map's photo positions."""
        return limit_accuracy(answer, self.opened.position_radius_px)

    def observe(
        self,
        photo_path: Path,
        *,
        top: int,
        hide: frozenset[int] = NOTHING,
        include: frozenset[int] = NOTHING,
        on_first: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Localize one photo by its content alone, before any prior; by tags, if it shows some of the map.

        Raises PhotoError.

        Args:
            on_first: Called with the answer of the first look, if a second one follows.
            include: Experience ids of which the best are verified even if the votes name none; unused by
                `vote`.
        """
        tagged = answer_by_tags(photo_path, self.map, settings=self.settings, fov_deg=self.fov_deg)
        if tagged.answer is not None:
            return truncate(tagged.answer, top)
        if not self.looks:
            return nothing_by_tags(tagged.note)
        answer = self._look_at(photo_path, top=top, hide=hide, include=include, on_first=on_first)
        return answer if not tagged.note else replace(answer, note=tagged.note)

    def _look_at(
        self,
        photo_path: Path,
        *,
        top: int,
        hide: frozenset[int],
        include: frozenset[int],
        on_first: Callable[[Answer], None] | None,
    ) -> Answer:
        photos = self._read(photo_path)
        hide, include = (pictures_of(ids, self.opened) for ids in (hide, include))
        one, *other = self.looks
        first = one.join([one.localize(photo, hide=hide, include=include) for photo in photos])
        if not other or looks.is_certain(first):
            return photos[0].on_file(truncate(first, top))
        if on_first is not None:
            on_first(photos[0].on_file(truncate(first, top)))
        (two,) = other
        turns = first.quarter_turns
        upright = [replace(photo, seconds=0.0).turned(turns) for photo in photos]
        further = two.join([two.localize(photo, hide=hide, include=include) for photo in upright])
        further = replace(upright[0].turned_back(further, quarters=turns), fov=first.fov)
        combined = looks.combine_looks(
            (first, further), calibration=self.both, place_radius_px=self.place_radius_px, top=top
        )
        return photos[0].on_file(combined)

    def _read(self, photo_path: Path) -> list[QueryPhoto]:
        described = (look.opened.indexed.global_descriptors for look in self.looks)
        describe = next((d.network for d in described if d is not None), None)
        return read_query(local(photo_path), settings=self.settings, fov_deg=self.fov_deg, describe=describe)

    @property
    def opened(self) -> OpenMap:
        """The map with the index of the first look.

        Raises:
            UsageError: The map has no photos.
        """
        if not self.looks:
            raise UsageError("the map has tags but no photos", hint="place photos on it first")
        return self.looks[0].opened

    @property
    def cfg(self) -> Path:
        """The map's file."""
        return self.opened.cfg if self.tags_alone is None else self.tags_alone.cfg

    @property
    def settings(self) -> Settings:
        """Settings with which the map was opened."""
        return self.opened.settings if self.tags_alone is None else self.tags_alone.settings

    @property
    def features(self) -> str:
        """Name of the features of the first look."""
        return self.looks[0].features if self.looks else "tags"

    @property
    def map(self) -> Map:
        """The map that photos are localized on."""
        return self.opened.map if self.tags_alone is None else self.tags_alone.map

    @property
    def map_hash(self) -> str:
        """Hash of the map's photos and positions."""
        return self.opened.map_hash

    @property
    def place_radius_px(self) -> float:
        """Largest error of a correct hypothesis, map pixels."""
        return _radius_of_tags(self.map) if not self.looks else place_radius_px(self.looks)

    @property
    def map_kind(self) -> MapKind:
        """Kind of the map: metric, areas, schematic or mixed."""
        if not self.looks:
            return "metric"
        kind, stored = self.opened.indexed.kind, self.looks[0].calibration
        schematic = stored is not None and stored.calibration.schematic
        return "schematic" if schematic and kind == "metric" else kind

    def answer_source(self, *, sequence: bool = False) -> AnswerSource:
        """Describe the method and the map of the answers, for their JSON."""
        return AnswerSource(
            self.method, self.features, self.map.georeference, self.map.revision,
            self.map_kind, self.place_radius_px, sequence, self.map.floors,
        )  # fmt: skip

    @property
    def build_seconds(self) -> float | None:
        """Build time of the indexes; None if unknown."""
        return _sum(look.opened.manifest.build_seconds for look in self.looks)

    @property
    def calibration_seconds(self) -> float | None:
        """Duration of the calibrations; None for a method without calibration."""
        return _sum(look.calibration.seconds for look in self.looks if look.calibration is not None)

    @property
    def index_bytes(self) -> int:
        """Size of the indexes on disk."""
        return sum(look.opened.folder.bytes_on_disk() for look in self.looks)


_TAG_PLACE_M = 2.0
"""Place radius on a map without photos, which would show what it is."""


def _radius_of_tags(the_map: Map) -> float:
    georeference = the_map.georeference
    at = next((point.position for point in tag_anchors(the_map.control_points)), None)
    return 1.0 if georeference is None or at is None else _TAG_PLACE_M / georeference.metres_per_pixel(at)


def place_radius_px(of: Iterable[Look]) -> float:
    """Return the larger place radius: features with more matches detect more noise of the positions."""
    return max(look.opened.indexed.place_radius_px for look in of)


def _sum(seconds: Iterable[float | None]) -> float | None:
    """Sum the known values; None if there are none."""
    known = [s for s in seconds if s is not None]
    return sum(known) if known else None
