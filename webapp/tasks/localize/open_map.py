"""Opens a map for localization: reads it, updates its index and loads it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from webapp.core.features.table import EXTRACTORS, FeatureChoice, Method, choose
from webapp.core.hypotheses.places import MapKind, PhotoGroups, describe_places
from webapp.core.landmarks.cloud import AlignedCloud
from webapp.core.mapmodel.accuracy import inexact_positions
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import LevelView, experience_of, experiences_of
from webapp.core.mapmodel.views import level_views, picture_name
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.flann import Flann
from webapp.core.retrieval.engines.ivf import InvertedFile
from webapp.core.retrieval.engines.segment import Segment
from webapp.core.retrieval.engines.tiers import tier_for
from webapp.core.retrieval.engines.twostage import TwoStage
from webapp.core.retrieval.engines.types import DescriptorSearch
from webapp.core.retrieval.fields_of_view import fields_of_view
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.tuning import DEFAULT, RetrievalTuning
from webapp.errors import IndexDamaged, MapError, NotReady
from webapp.files.localize.features import read_codebook, read_segment, read_signatures
from webapp.files.localize.index_store import IndexFolder, Manifest, read_search_index
from webapp.files.localize.models import pair_matcher, pair_matcher_if_installed, with_weights
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import build_index
from webapp.tasks.localize.build_index import BuildReport, BuildRequest
from webapp.tasks.localize.extract_photo import size_and_time
from webapp.tasks.localize.index_location import index_bases, index_folder, newest_choice


@dataclass(frozen=True, slots=True)
class OpenOptions:
    """Requested options; None selects a default."""

    method: Method = "auto"
    features: str = "auto"
    detector: str | None = None
    extractor: str | None = None
    matcher: str | None = None
    index: Path | None = None
    """Folder for the indexes, instead of `derived` next to the map."""
    jobs: int | None = None
    map_fov_deg: float | None = None
    """Horizontal field of view of map photos whose EXIF does not state theirs."""
    right_within_px: float | None = None
    """Place radius, instead of the one derived from the map."""
    map_kind: MapKind | None = None
    """Kind of the map, instead of the one inferred from positions and relative poses of the photos."""
    second_look: bool = False
    """The map is opened for the second look of `auto`: an installed network matches the best photos."""
    build: bool = True
    """Update the index; if False, use the existing one unchanged."""

    def choice(self) -> FeatureChoice:
        """Resolve the features; `auto` takes the method's default.

        Raises
        ------
        UsageError
            The combination is not possible.
        """
        return choose(
            self.method,
            features=self.features,
            detector=self.detector,
            extractor=self.extractor,
            matcher=self.matcher,
        )


@dataclass(frozen=True, slots=True, eq=False)
class OpenMap:
    """A map ready for localization.

    Attributes
    ----------
    writable : Path
        Folder for files computed from the index: the index folder, or one in the cache if that is read-only.
    built : BuildReport or None
        Set if the index had to be built or updated.
    landmarks : AlignedCloud or None
        For method `landmarks`.
    pictures : tuple of Experience
        The indexed pictures: photos, and the level views of panoramas.
    views : mapping of int to LevelView
        The level views among the pictures, by id.
    position_radius_px : mapping of int to float
        68 % radii of the experiences with inexact positions, by id.
    """

    cfg: Path
    map: Map
    method: Method
    choice: FeatureChoice
    folder: IndexFolder
    writable: Path
    manifest: Manifest
    indexed: IndexedMap
    built: BuildReport | None
    options: OpenOptions
    settings: Settings
    landmarks: AlignedCloud | None = None
    pictures: tuple[Experience, ...] = field(init=False)
    views: Mapping[int, LevelView] = field(init=False)
    position_radius_px: Mapping[int, float] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pictures", pictures := level_views(self.map.experiences))
        object.__setattr__(self, "views", {e.id: e.view for e in pictures if e.view is not None})
        object.__setattr__(self, "position_radius_px", inexact_positions(self.map))

    def artifact_paths(self, name: str) -> tuple[Path, Path]:
        """Return the paths of a file computed from the index: next to the index, and where it is written."""
        return self.folder.folder / name, self.writable / name

    @property
    def contents(self) -> list[str]:
        """Content hash of each picture, in the map's order; empty if it is not in the index."""
        return _contents(self.pictures, self.manifest)

    @property
    def not_indexed(self) -> int:
        """Number of the map's photos missing from the index in their current form (new, renamed, blurred)."""
        record = self.manifest.record_of
        return len({experience_of(e.id) for e in self.pictures if record(e.id, picture_name(e)) is None})

    @property
    def map_hash(self) -> str:
        """Hash of the map's photos and positions, 16 hexadecimal characters."""
        pairs = zip(self.pictures, self.contents, strict=True)
        photos = [[e.id, c, *e.position, *([e.floor] if e.floor else [])] for e, c in pairs]
        return hashlib.sha256(json.dumps(photos).encode()).hexdigest()[:16]


def open_index(
    cfg: Path, options: OpenOptions, *, settings: Settings, progress: Progress, the_map: Map | None = None
) -> OpenMap:
    """Open a map.

    Parameters
    ----------
    the_map : Map, optional
        Content of the file, if it has been read already.

    Raises
    ------
    MapError
        It cannot be read, or has no photo with features.
    UsageError
        The combination of features is not possible.
    NotReady
        There is no index, and `options.build` is False.
    MissingPart
        The features need a model that is not installed.
    InputError
        The model file supplied by the user is of another kind.
    StorageError, IndexDamaged, Cancelled
    """
    bases = index_bases(cfg, options.index)
    # Fail early: report missing parts before building anything.
    choice = with_weights(_choice(bases, options, settings=settings), settings.models, method=options.method)
    the_map = read_map(cfg) if the_map is None else the_map
    choice = within_memory(choice, the_map, options=options, settings=settings)
    if not the_map.experiences:
        raise MapError("the map has no photos", where=str(cfg), hint="place photos on it first")
    folders = [IndexFolder(index_folder(b, choice, extract=settings.extract)) for b in bases]
    folder, built = next((f for f in folders if _is_up_to_date(f, the_map, cfg, choice=choice)), None), None
    if folder is None and not options.build:
        folder = _as_it_is(folders, cfg=cfg)
    if folder is None:
        folder = folders[-1]
        new = not folder.manifest_path.exists()
        progress.note("building the index" if new else "the map has changed: updating its index")
        request = BuildRequest(cfg, the_map, folder.folder, choice, options.jobs)
        built = build_index.update_index(request, settings=settings, progress=progress)
    manifest, indexed = _load_latest(the_map, folder, cfg=cfg, choice=choice, options=options)
    matcher = None
    if options.method == "thorough":
        matcher = pair_matcher(choice.name, settings.models)
    elif options.second_look:
        matcher = pair_matcher_if_installed(choice.name, settings.models)
    tuning = replace(DEFAULT, retrieval=RetrievalTuning(shortlist=settings.retrieval.shortlist))
    indexed = replace(
        indexed,
        pair_matcher=matcher,
        rematched=tuning.retrieval.second_look_photos if options.second_look else None,
        tuning=tuning,
        extract_side_px=settings.extract.max_side_px,
    )
    choice = _as_built(choice, manifest)
    at = folder, folders[-1].folder
    return OpenMap(cfg, the_map, options.method, choice, *at, manifest, indexed, built, options, settings)


def within_memory(
    choice: FeatureChoice, the_map: Map, *, options: OpenOptions, settings: Settings
) -> FeatureChoice:
    """Choose a matcher that fits into memory, unless one was requested.

    The decision rests on the number of photos and the maximum number of keypoints, both known in advance.
    """
    if options.matcher is not None or choice.engine is None:
        return choice
    rows = len(level_views(the_map.experiences)) * settings.extract.keypoints
    memory_mb = settings.retrieval.memory_mb
    return replace(choice, matcher=tier_for(rows, width=choice.width, kind=choice.kind, memory_mb=memory_mb))


def _as_built(choice: FeatureChoice, manifest: Manifest) -> FeatureChoice:
    """Choose the engine of the index, which may differ from the requested one if nothing is built."""
    return choice if choice.engine is None else replace(choice, matcher=manifest.engine)


def with_positions(opened: OpenMap, the_map: Map, *, options: OpenOptions) -> OpenMap:
    """Replace the positions of an open map, reusing its loaded index.

    Parameters
    ----------
    opened : OpenMap
        Its index must still be the newest.
    the_map : Map
        Its photos may have changed, too.
    options : OpenOptions
        Options with which it was opened.
    """
    if not the_map.experiences:
        raise MapError("the map has no photos", where=str(opened.cfg), hint="place photos on it first")
    old = opened.indexed
    indexed = _indexed(the_map, _Loaded(old.segments, old.search), manifest=opened.manifest, options=options)
    indexed = replace(
        indexed,
        pair_matcher=old.pair_matcher,
        rematched=old.rematched,
        tuning=old.tuning,
        extract_side_px=old.extract_side_px,
    )
    return replace(opened, map=the_map, indexed=indexed, built=None)


def _as_it_is(folders: Sequence[IndexFolder], *, cfg: Path) -> IndexFolder:
    """Find the most recently written index, even if it lacks photos.

    Raises
    ------
    NotReady
        There is none with any photo in it.
    IndexDamaged
    """
    there = [f for f in folders if (manifest := f.read_manifest()) is not None and manifest.codebook]
    if not there:
        raise NotReady(
            "the map has no index with these features yet", where=str(cfg), hint="run expmap build on it"
        )
    return max(there, key=lambda f: f.manifest_path.stat().st_mtime_ns)


def _choice(bases: Sequence[Path], options: OpenOptions, *, settings: Settings) -> FeatureChoice:
    """Resolve the requested features; `auto` takes those of the newest index."""
    if options.features == "auto" and options.detector is None and options.extractor is None:
        return newest_choice(
            bases,
            settings.extract,
            method=options.method,
            matcher=options.matcher,
            models=settings.models,
        )
    return options.choice()


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
    the_map: Map, folder: IndexFolder, *, cfg: Path, choice: FeatureChoice, options: OpenOptions
) -> tuple[Manifest, IndexedMap]:
    """Load the files that the manifest names; retry if a build has replaced them meanwhile."""
    manifest = folder.read_manifest()
    while manifest is not None and manifest.codebook:
        try:
            return manifest, _load(the_map, folder, manifest=manifest, choice=choice, options=options)
        except IndexDamaged:
            before, manifest = manifest, folder.read_manifest()
            if manifest == before:
                raise
    failed = [(p.photo, p.error) for p in manifest.photos.values() if p.error] if manifest else []
    message = "no photo of the map has features to recognise it by"
    if failed:
        message = f"no photo of the map can be used; {build_index.count_reasons(failed)}"
    raise MapError(message, where=str(cfg), hint="run expmap map check on it")


def _contents(pictures: Sequence[Experience], manifest: Manifest) -> list[str]:
    """Look up the content hash of each picture; empty if it is not in the index."""
    return [r.content if (r := manifest.record_of(e.id, picture_name(e))) else "" for e in pictures]


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """The loaded files of an index."""

    segments: Sequence[Segment]
    search: DescriptorSearch | TwoStage


def _load(
    the_map: Map, folder: IndexFolder, *, manifest: Manifest, choice: FeatureChoice, options: OpenOptions
) -> IndexedMap:
    folder.fetch(manifest)
    choice = _as_built(choice, manifest)
    in_file = choice.matcher == "vlad"
    segments = [read_segment(folder.segment_path(s.name), in_file=in_file) for s in manifest.segments]
    loaded = _Loaded(segments, _search(folder, manifest, segments, choice=choice))
    return _indexed(the_map, loaded, manifest=manifest, options=options)


def _indexed(the_map: Map, loaded: _Loaded, *, manifest: Manifest, options: OpenOptions) -> IndexedMap:
    segments = loaded.segments
    contents = [c for s in segments for c in s.content]
    pictures = level_views(the_map.experiences)
    # If several experiences have the same photo, matches are assigned to the first.
    number = {c: i for i, c in reversed([*enumerate(_contents(pictures, manifest))])}
    ids = np.array([e.id for e in pictures], np.int64)
    position = np.array([e.position for e in pictures], np.float64).reshape(-1, 2)
    photo_of_entry = np.array([number.get(c, -1) for c in contents], np.int64)
    floor = np.array([e.floor for e in pictures], np.int64)
    size = the_map.satellite
    groups = PhotoGroups(experiences_of(ids), floor)
    places = describe_places(
        position, trust=None, size=(size.width, size.height), kind=options.map_kind, groups=groups
    )
    return IndexedMap(
        ids=ids,
        position=position,
        fov_deg=fields_of_view(
            [e.fov_deg for e in pictures],
            segments,
            photo_of_entry=photo_of_entry,
            given=options.map_fov_deg,
        ),
        segments=segments,
        photo_of_entry=photo_of_entry,
        search=loaded.search,
        binary=EXTRACTORS[manifest.extractor]().kind == "binary",
        place_radius_px=options.right_within_px or places.radius_px,
        kind=places.kind,
        kind_is_given=options.map_kind is not None,
        area=places.area,
        floor=floor,
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
