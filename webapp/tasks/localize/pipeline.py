"""The localization of one photo, stage by stage.

1. read: decode the photo upright and downscaled, read its field of view and, where a model is installed,
   compute its global descriptor; cut a panorama into views, each of which passes through the following
   stages (`query_photo`);
2. extract: keypoints and descriptors (`core.features`);
3. retrieve, verify, position: matching map photos, relative poses, positions (`core.localize`);
4. calibrate: evidence becomes probabilities (`core.hypotheses.calibration`);
5. prior: queries are likely near the map's photos and on the paths between them
   (`core.hypotheses.path_prior`).

If the answer is uncertain, method `auto` repeats stages 2 to 4 with other features and combines both looks
(`core.hypotheses.looks`).

`observe` stops before the prior: several photos of one spot (`spot.py`) and the frames of a sequence
(`sequence.py`) are combined first and have their own priors.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from webapp.core.features.extract import extract
from webapp.core.features.table import Method
from webapp.core.features.types import Features
from webapp.core.hypotheses import joint, looks
from webapp.core.hypotheses.bayes import truncate
from webapp.core.hypotheses.calibration import DEFAULT, Calibration
from webapp.core.hypotheses.heading_prior import relative_to_north
from webapp.core.hypotheses.jsonform import AnswerSource
from webapp.core.hypotheses.map_accuracy import limit_accuracy
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.path_prior import apply_path_prior_to_answer
from webapp.core.hypotheses.places import MapKind
from webapp.core.localize import vote
from webapp.core.localize.verified import with_probabilities
from webapp.core.mapmodel.model import Map
from webapp.core.reconstruction.depths import DepthObservations, DepthsExcluding
from webapp.errors import InputError, MapError, MissingPart
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.localize.models import network
from webapp.files.maps.folder import read_map
from webapp.files.object_storage.storage import local
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.on_demand import LandmarksAround, options_for_retrieval
from webapp.tasks.localize import (
    calibrate,
    cascade,
    describe_photos,
    geometry,
    open_map,
)
from webapp.tasks.localize.open_map import OpenMap, OpenOptions
from webapp.tasks.localize.query_photo import QueryPhoto, pictures_of, read_query, to_experiences
from webapp.telemetry import span

_ALL = 100
"""Maximum number of hypotheses of a look, large enough to keep all."""


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


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationPipeline:
    """A method on an open map.

    Attributes
    ----------
    calibration : StoredCalibration or None
        None for a method without calibration.
    fov_deg : float or None
        Horizontal field of view of the queries, instead of the one in their EXIF.
    sightings : DepthObservations or None
        Depth observations of the map's keypoints, to compute depths without the photos that are hidden. If
        None, no depths are used when photos are hidden.
    asked : Method or None
        The requested method, where it differs from that of the open map (`auto`, landmarks on demand).
    second : LocalizationPipeline or None
        The second look of `auto`.
    both : Calibration
        Calibration of the two looks combined.
    around : LandmarksAround or None
        Solves the camera pose from landmarks made on demand, for a map without landmarks.
    """

    opened: OpenMap
    settings: Settings
    calibration: StoredCalibration | None = None
    fov_deg: float | None = None
    sightings: DepthObservations | None = None
    asked: Method | None = None
    second: LocalizationPipeline | None = None
    both: Calibration = looks.DEFAULT
    around: LandmarksAround | None = None

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Localize one photo by all stages.

        Parameters
        ----------
        top : int
            Maximum number of hypotheses.
        hide : frozenset of int
            Experience ids to leave out.

        Raises
        ------
        PhotoError
            The photo cannot be used.
        """
        answer = self.observe(photo_path, top=top, hide=hide)
        return self.limit_accuracy(apply_path_prior_to_answer(answer, self.opened.indexed.paths))

    def limit_accuracy(self, answer: Answer) -> Answer:
        """Enlarge the radii of a final answer to at least the accuracy of the map's photo positions."""
        return limit_accuracy(answer, self.opened.position_radius_px)

    def observe(
        self,
        photo_path: Path,
        *,
        top: int,
        hide: frozenset[int] = frozenset(),
        include: frozenset[int] = frozenset(),
    ) -> Answer:
        """Localize one photo by its content alone, before any prior.

        Parameters
        ----------
        include : frozenset of int
            Experience ids of which the best are verified even if the votes name none; unused by `vote`.

        Raises
        ------
        PhotoError
        """
        photos = self._read(photo_path)
        hide, include = (pictures_of(ids, self.opened) for ids in (hide, include))
        first = self._look_at_all(photos, hide=hide, include=include)
        if self.second is None or looks.is_certain(first):
            return truncate(first, top)
        turns = first.quarter_turns
        upright = [replace(photo, seconds=0.0).turned(turns) for photo in photos]
        further = self.second._look_at_all(upright, hide=hide, include=include)
        further = replace(upright[0].turned_back(further, quarters=turns), fov=first.fov)
        return looks.combine_looks(
            (first, further), calibration=self.both, place_radius_px=self.place_radius_px, top=top
        )

    def _look_at_all(
        self, photos: Sequence[QueryPhoto], *, hide: frozenset[int], include: frozenset[int]
    ) -> Answer:
        """Localize a photo, or the views of a panorama, which are photos of one spot."""
        answers = [self._look(photo, hide=hide, include=include) for photo in photos]
        return joint.combine(answers, paths=self.opened.indexed.paths, top=_ALL)

    def _look(self, photo: QueryPhoto, *, hide: frozenset[int], include: frozenset[int]) -> Answer:
        """Localize with the pipeline's own features, without the second look."""
        watch = _Stopwatch({"read": photo.seconds})
        with watch.stage("extract"):
            features = self._extract(photo)
        indexed, fov = self.opened.indexed, photo.fov
        if self.method == "vote":
            with watch.stage("retrieve"):
                answer = vote.localize(indexed, features, top=_ALL, hide=hide)
            answer = to_experiences(answer, self.opened)
            if photo.view is not None:
                answer = photo.view.to_panorama(answer)
            return replace(answer, seconds=watch.total(), looks=(self.features,))
        found = geometry.find_places(
            self.opened,
            features,
            fov_deg=fov.degrees,
            hide=hide,
            closer=include,
            depths=self._depths_without(hide) if hide else None,
        )
        calibration = self.calibration.calibration if self.calibration else DEFAULT
        answer = with_probabilities(indexed, found, calibration=calibration, top=_ALL)
        answer = replace(to_experiences(answer, self.opened), fov=fov)
        if self.around is not None:
            answer = self.around.refine(answer, self.opened, query=features, fov_deg=fov.degrees, hide=hide)
        if photo.view is not None:
            answer = photo.view.to_panorama(answer)
        answer = relative_to_north(answer, self.map.georeference)
        seconds = {**found.answer.seconds, **watch.total()}
        return replace(answer, seconds=seconds, looks=(self.features,))

    def _read(self, photo_path: Path) -> list[QueryPhoto]:
        described = (o.indexed.global_descriptors for o in self.all_opened)
        describe = next((d.network for d in described if d is not None), None)
        return read_query(local(photo_path), settings=self.settings, fov_deg=self.fov_deg, describe=describe)

    def _extract(self, photo: QueryPhoto) -> Features:
        choice, gray = self.opened.choice, photo.gray
        features = extract(
            gray.pixels,
            choice,
            keypoints=self.settings.extract.keypoints,
            scale=gray.scale,
            photo_size=gray.full_size,
            network=network(choice.model, self.settings.models, weights=choice.weights),
        )
        return replace(features, vector=photo.vector)

    def _depths_without(self, hide: frozenset[int]) -> DepthsExcluding | None:
        if self.sightings is None:
            return None
        return DepthsExcluding(self.sightings, np.isin(self.opened.indexed.ids, [*hide]))

    @property
    def method(self) -> Method:
        """Name of the method."""
        return self.asked or self.opened.method

    @property
    def features(self) -> str:
        """Name of the features, `auto` resolved."""
        return self.opened.choice.name

    @property
    def map(self) -> Map:
        """The map that photos are localized on."""
        return self.opened.map

    @property
    def map_hash(self) -> str:
        """Hash of the map's photos and positions."""
        return self.opened.map_hash

    @property
    def place_radius_px(self) -> float:
        """Largest error of a correct hypothesis, map pixels."""
        return cascade.place_radius_px(self.all_opened)

    @property
    def all_opened(self) -> tuple[OpenMap, ...]:
        """The map with the index of each look."""
        return (self.opened,) if self.second is None else (self.opened, self.second.opened)

    @property
    def map_kind(self) -> MapKind:
        """Kind of the map: metric, areas, schematic or mixed."""
        kind = self.opened.indexed.kind
        schematic = self.calibration is not None and self.calibration.calibration.schematic
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
        return _sum(o.manifest.build_seconds for o in self.all_opened)

    @property
    def calibration_seconds(self) -> float | None:
        """Duration of the calibrations; None for a method without calibration."""
        stored = (self.calibration, self.second.calibration if self.second else None)
        return _sum(c.seconds for c in stored if c is not None)

    @property
    def index_bytes(self) -> int:
        """Size of the indexes on disk."""
        return sum(o.folder.bytes_on_disk() for o in self.all_opened)


def _sum(seconds: Iterable[float | None]) -> float | None:
    """Sum the known values; None if there are none."""
    known = [s for s in seconds if s is not None]
    return sum(known) if known else None


def open_pipeline(
    cfg: Path,
    options: OpenOptions,
    *,
    settings: Settings,
    progress: Progress,
    fov_deg: float | None = None,
) -> LocalizationPipeline:
    """Open a map for localization: update its index and orientations, and calibrate its probabilities.

    Parameters
    ----------
    fov_deg : float, optional
        Horizontal field of view of the queries, instead of the one in their EXIF.

    Raises
    ------
    MapError, UsageError, StorageError, IndexDamaged, Cancelled
    """
    options.choice()  # fail early: check the options before reading any file
    the_map = read_map(cfg)
    asked, options = options.method, options_for_retrieval(cfg, options, settings=settings)
    around = None if options.method == asked else LandmarksAround(settings, progress, build=True)
    newest = cascade.newest_features(cfg, options, settings=settings)
    one, *further = cascade.look_options(options, first=newest, settings=settings)
    first = _open_look(cfg, one, the_map=the_map, settings=settings, progress=progress)
    first = replace(first, fov_deg=fov_deg, asked=asked, around=around)
    if not further:
        return first
    try:
        look = cascade.with_same_kind(further[0], first.opened)
        progress.note(f"second look: {look.features}")
        second = _open_look(cfg, look, the_map=the_map, settings=settings, progress=progress)
    except (MapError, MissingPart, InputError) as error:
        progress.note(f"without a second look: {error}")
        return first
    return with_second_look(first, second, progress=progress)


def _open_look(
    cfg: Path, options: OpenOptions, *, the_map: Map, settings: Settings, progress: Progress
) -> LocalizationPipeline:
    opened = open_map.open_index(cfg, options, settings=settings, progress=progress, the_map=the_map)
    if opened.method == "vote":
        return LocalizationPipeline(opened, settings)
    opened = describe_photos.describe_photos(opened, settings=settings, progress=progress)
    opened = geometry.prepare_geometry(opened, progress=progress)
    stored = calibrate.calibrate_map(opened, map_fov_deg=options.map_fov_deg, progress=progress)
    return LocalizationPipeline(opened, settings, stored)


def with_second_look(
    first: LocalizationPipeline, second: LocalizationPipeline, *, progress: Progress
) -> LocalizationPipeline:
    """Add a second look to a pipeline and calibrate both together; each must be calibrated by itself.

    Raises
    ------
    StorageError, Cancelled
    """
    opened = (first.opened, second.opened)
    if first.calibration is None or second.calibration is None:
        raise ValueError("both looks have to be calibrated")
    if not cascade.share_areas(*opened):
        progress.note("without a second look: its features show other areas")
        return first
    calibrations = cascade.agree_on_scale(first.calibration.calibration, second.calibration.calibration)
    both = cascade.calibrate_looks(opened, calibrations, progress=progress)
    if not cascade.is_within_budget(both, first.settings):
        progress.note("without a second look: it would exceed the time budget")
        return first
    return join_looks(first, second, calibrations=calibrations, both=both.calibration)


def join_looks(
    first: LocalizationPipeline,
    second: LocalizationPipeline,
    *,
    calibrations: tuple[Calibration, Calibration],
    both: Calibration,
) -> LocalizationPipeline:
    """Combine two looks; `calibrations` are those returned by `cascade.agree_on_scale`."""
    if first.calibration is None or second.calibration is None:
        raise ValueError("both looks have to be calibrated")
    one = replace(first.calibration, calibration=calibrations[0])
    other = replace(second.calibration, calibration=calibrations[1])
    return replace(first, calibration=one, second=replace(second, calibration=other), both=both)
