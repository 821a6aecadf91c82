"""Loads the index of a map for one look, updating it first if planned; or again in another process."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.table import EXTRACTORS, FeatureChoice
from webapp.core.hypotheses.places import PhotoGroups, describe_places
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import experiences_of
from webapp.core.mapmodel.views import level_views, picture_name
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.flann import Flann
from webapp.core.retrieval.engines.ivf import InvertedFile
from webapp.core.retrieval.engines.twostage import TwoStage
from webapp.core.retrieval.engines.types import DescriptorSearch, Segment, tier_for
from webapp.core.retrieval.fields_of_view import fields_of_view
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.tuning import DEFAULT, RetrievalTuning
from webapp.errors import Conflict, IndexDamaged, MapError, NotReady
from webapp.files.localize.features import read_codebook, read_segment, read_signatures
from webapp.files.localize.index_store import IndexFolder, Manifest, read_search_index
from webapp.files.localize.models import (
    global_descriptor,
    pair_matcher,
    pair_matcher_if_installed,
    with_weights,
)
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import build_index, describe_photos
from webapp.tasks.localize.build_index import BuildRequest
from webapp.tasks.localize.extract_photo import size_and_time
from webapp.tasks.localize.index_location import index_bases, index_folder
from webapp.tasks.localize.open_map import OpenMap, contents_of
from webapp.tasks.localize.plan import LookPlan


def open_index(cfg: Path, plan: LookPlan, *, the_map: Map, settings: Settings, progress: Progress) -> OpenMap:
    """Open a map, without its geometry and global descriptors.

    Raises:
        MapError: It has no photo with features.
        NotReady: There is no index, and `plan.build` is False.
        MissingPart: The features need a model that is not installed.
        InputError: The model file supplied by the user is of another kind.
        StorageError, IndexDamaged, Cancelled
    """
    # Fail early: report missing parts before building anything.
    choice = features_for(plan, the_map, settings=settings)
    if not the_map.experiences:
        raise MapError("the map has no photos", where=str(cfg), hint="place photos on it first")
    bases = index_bases(cfg, plan.index)
    folders = [IndexFolder(index_folder(b, choice, extract=settings.extract)) for b in bases]
    folder, built = next((f for f in folders if _is_up_to_date(f, the_map, cfg, choice=choice)), None), None
    if folder is None and not plan.build:
        folder = _as_it_is(folders, cfg=cfg)
    if folder is None:
        folder = folders[-1]
        new = not folder.manifest_path.exists()
        progress.note("building the index" if new else "the map has changed: updating its index")
        request = BuildRequest(cfg, the_map, folder.folder, choice, plan.jobs)
        built = build_index.update_index(request, settings=settings, progress=progress)
    manifest, loaded = _load_latest(folder, cfg=cfg, choice=choice, plan=plan, settings=settings)
    indexed = _indexed(the_map, loaded, manifest=manifest, plan=plan, settings=settings)
    choice, writable = _as_built(choice, manifest), folders[-1].folder
    return OpenMap(cfg, the_map, choice, folder, writable, manifest, indexed, built, plan, settings)


def features_for(plan: LookPlan, the_map: Map, *, settings: Settings) -> FeatureChoice:
    """Return the planned features with their weights, and a matcher that fits into memory.

    A requested matcher is kept. The decision rests on the number of photos and the maximum number of
    keypoints, both known in advance. Raises MissingPart, InputError, StorageError.
    """
    choice = with_weights(plan.choice, settings.models, method=plan.method)
    if plan.keeps_matcher or choice.engine is None:
        return choice
    rows = len(level_views(the_map.experiences)) * settings.extract.keypoints
    memory_mb = settings.retrieval.memory_mb
    return replace(choice, matcher=tier_for(rows, width=choice.width, kind=choice.kind, memory_mb=memory_mb))


def _as_built(choice: FeatureChoice, manifest: Manifest) -> FeatureChoice:
    """Choose the engine of the index, which may differ from the requested one if nothing is built."""
    return choice if choice.engine is None else replace(choice, matcher=manifest.engine)


def with_positions(opened: OpenMap, the_map: Map) -> OpenMap:
    """Replace the positions of an open map, reusing its loaded index, which must still be the newest.

    The photos of the map may have changed, too.
    """
    if not the_map.experiences:
        raise MapError("the map has no photos", where=str(opened.cfg), hint="place photos on it first")
    old = opened.indexed
    loaded = _Loaded(old.segments, old.search, old.pair_matcher)
    indexed = _indexed(the_map, loaded, manifest=opened.manifest, plan=opened.plan, settings=opened.settings)
    return replace(opened, map=the_map, indexed=indexed, built=None)


def _as_it_is(folders: Sequence[IndexFolder], *, cfg: Path) -> IndexFolder:
    """Find the most recently written index, even if it lacks photos.

    Raises:
        NotReady: There is none with any photo in it.
        IndexDamaged
    """
    there = [f for f in folders if (manifest := f.read_manifest()) is not None and manifest.codebook]
    if not there:
        raise NotReady(
            "the map has no index with these features yet", where=str(cfg), hint="run expmap build on it"
        )
    return max(there, key=lambda f: f.manifest_path.stat().st_mtime_ns)


def _is_up_to_date(folder: IndexFolder, the_map: Map, cfg: Path, *, choice: FeatureChoice) -> bool:
    manifest = folder.read_manifest()
    if manifest is None or choice.engine not in (None, manifest.engine):
        return False
    return _current(the_map, manifest, map_folder=cfg.parent)


def _current(the_map: Map, manifest: Manifest, *, map_folder: Path) -> bool:
    pictures = level_views(the_map.experiences)
    if manifest.photos.keys() != {e.id for e in pictures}:
        return False
    return all(
        build_index.is_current(e, manifest, map_folder=map_folder)
        or _still_failing(e, manifest, map_folder=map_folder)
        for e in pictures
    )


def _still_failing(experience: Experience, manifest: Manifest, *, map_folder: Path) -> bool:
    """Check whether a photo that failed before is still the same file, or still missing."""
    record = manifest.record_of(experience.id, picture_name(experience))
    if record is None or not record.error:
        return False
    return (record.bytes, record.mtime_ns) == size_and_time(map_folder / experience.photo)


def _load_latest(
    folder: IndexFolder, *, cfg: Path, choice: FeatureChoice, plan: LookPlan, settings: Settings
) -> tuple[Manifest, _Loaded]:
    """Load the files that the manifest names; retry if a build has replaced them meanwhile."""
    manifest = folder.read_manifest()
    while manifest is not None and manifest.codebook:
        try:
            return manifest, _load(folder, manifest, choice=choice, plan=plan, settings=settings)
        except IndexDamaged:
            before, manifest = manifest, folder.read_manifest()
            if manifest == before:
                raise
    failed = [(p.photo, p.error) for p in manifest.photos.values() if p.error] if manifest else []
    message = "no photo of the map has features to recognise it by"
    if failed:
        message = f"no photo of the map can be used; {build_index.count_reasons(failed)}"
    raise MapError(message, where=str(cfg), hint="run expmap map check on it")


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """The loaded files of an index, and the network that matches its photos."""

    segments: Sequence[Segment]
    search: DescriptorSearch | TwoStage
    pair_matcher: PairMatcher | None


def _load(
    folder: IndexFolder, manifest: Manifest, *, choice: FeatureChoice, plan: LookPlan, settings: Settings
) -> _Loaded:
    folder.fetch(manifest)
    choice = _as_built(choice, manifest)
    in_file = choice.matcher == "vlad"
    segments = [read_segment(folder.segment_path(s.name), in_file=in_file) for s in manifest.segments]
    matcher = None
    if plan.method == "thorough":
        matcher = pair_matcher(choice.name, settings.models)
    elif plan.is_second:
        matcher = pair_matcher_if_installed(choice.name, settings.models)
    return _Loaded(segments, _search(folder, manifest, segments, choice=choice), matcher)


def _indexed(
    the_map: Map, loaded: _Loaded, *, manifest: Manifest, plan: LookPlan, settings: Settings
) -> IndexedMap:
    segments = loaded.segments
    contents = [c for s in segments for c in s.content]
    pictures = level_views(the_map.experiences)
    # If several experiences have the same photo, matches are assigned to the first.
    number = {c: i for i, c in reversed([*enumerate(contents_of(pictures, manifest))])}
    ids = np.array([e.id for e in pictures], np.int64)
    position = np.array([e.position for e in pictures], np.float64).reshape(-1, 2)
    photo_of_entry = np.array([number.get(c, -1) for c in contents], np.int64)
    floor = np.array([e.floor for e in pictures], np.int64)
    size = the_map.satellite
    groups = PhotoGroups(experiences_of(ids), floor)
    places = describe_places(
        position, trust=None, size=(size.width, size.height), kind=plan.map_kind, groups=groups
    )
    tuning = replace(DEFAULT, retrieval=RetrievalTuning(shortlist=settings.retrieval.shortlist))
    return IndexedMap(
        ids=ids,
        position=position,
        fov_deg=fields_of_view(
            [e.fov_deg for e in pictures],
            segments,
            photo_of_entry=photo_of_entry,
            given=plan.map_fov_deg,
        ),
        segments=segments,
        photo_of_entry=photo_of_entry,
        search=loaded.search,
        place_radius_px=plan.right_within_px or places.radius_px,
        kind=places.kind,
        kind_is_given=plan.map_kind is not None,
        area=places.area,
        floor=floor,
        pair_matcher=loaded.pair_matcher,
        rematched=tuning.retrieval.second_look_photos if plan.is_second else None,
        binary=EXTRACTORS[manifest.extractor].make().kind == "binary",
        tuning=tuning,
        extract_side_px=settings.extract.max_side_px,
    )


def _search(
    folder: IndexFolder, manifest: Manifest, segments: list[Segment], *, choice: FeatureChoice
) -> DescriptorSearch | TwoStage:
    trained, engine = manifest.codebook, manifest.engine
    codes = [folder.codes_path(s.name, codebook=trained, engine=engine) for s in manifest.segments]
    if choice.matcher == "ivf":
        return InvertedFile([read_search_index(p, choice.kind) for p in codes])
    if choice.matcher == "vlad":
        codebook = read_codebook(folder.codebook_path(trained))
        return TwoStage(codebook, [read_signatures(p, codebook) for p in codes], segments=segments)
    descriptors = [s.descriptors for s in segments]
    if choice.matcher == "flann":
        return Flann(descriptors, choice.kind)
    return BruteForce(descriptors, choice.matcher)


Value = TypeVar("Value")


class RebuiltValue(Generic[Value]):
    """A value that is not pickled: other processes create it again.

    Args:
        make: Creates the value; this is what is pickled.
        value: The value, if it exists already.
    """

    def __init__(self, make: Callable[[], Value], value: Value | None = None) -> None:
        self._make = make
        self._value = value
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the value."""
        return RebuiltValue, (self._make,)

    def value(self) -> Value:
        """Return the value; the first call in a process creates it."""
        with self._lock:
            if self._value is None:
                self._value = self._make()
            return self._value


@dataclass(frozen=True, slots=True)
class MapSource:
    """All that is needed to open a map again."""

    cfg: Path
    the_map: Map
    plan: LookPlan  # With the features of the open map
    settings: Settings
    map_hash: str  # Hash of the open map
    has_global_descriptors: bool

    @classmethod
    def of(cls, opened: OpenMap) -> MapSource:
        """Collect them from an open map."""
        return cls(
            opened.cfg.absolute(),
            opened.map,
            replace(opened.plan, choice=opened.choice, keeps_matcher=True, build=False),
            replace(opened.settings, dask=None),
            opened.map_hash,
            opened.indexed.global_descriptors is not None,
        )

    def open(self) -> OpenMap:
        """Open the map, without its geometry.

        Raises:
            Conflict: Its index has been changed meanwhile.
            MissingPart, InputError, StorageError, IndexDamaged
        """
        opened = open_index(
            self.cfg, self.plan, the_map=self.the_map, settings=self.settings, progress=Progress()
        )
        network = global_descriptor(self.settings.models) if self.has_global_descriptors else None
        if network is not None:
            opened = describe_photos.with_stored_vectors(opened, network)
        if opened.map_hash != self.map_hash:
            raise Conflict(
                "the index of the map was changed meanwhile", where=str(self.cfg), hint="start again"
            )
        return opened
