"""Structure from motion of a map's photos, placed or not; stored next to the index, with reuse of matches."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.table import FeatureChoice, choose
from webapp.core.features.types import Features
from webapp.core.geo.types import MapPixel
from webapp.core.landmarks.heights import Altitude
from webapp.core.landmarks.matching import Pairs, Views, choose_pairs, match_mutually
from webapp.core.landmarks.submodels import LEAST_PHOTOS, Submodel, of_photos
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.views import content_of, level_views
from webapp.core.retrieval.engines.types import PhotoEntry
from webapp.core.retrieval.fields_of_view import guessed_fov_deg
from webapp.errors import IndexDamaged, MapError
from webapp.files.atomic import make_folder, remove_unfinished
from webapp.files.landmarks.cloud import CLOUD_FILE, StoredCloud, read_cloud, read_models, write_cloud
from webapp.files.landmarks.colmap import (
    RIGID_FILE,
    SUBMODELS_FILE,
    StoredSubmodels,
    read_submodels,
    write_submodels,
)
from webapp.files.landmarks.match_database import (
    MatchDatabase,
    StoredPhoto,
    ViewFeatures,
    stored_photo,
    two_view_geometry,
)
from webapp.files.listing import natural_key
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder, Manifest
from webapp.files.localize.models import pair_matcher, usable_features, with_weights
from webapp.files.lock import writer_lock
from webapp.files.maps.folder import photo_hash
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.landmarks.altitudes import read_altitudes
from webapp.tasks.landmarks.known import AnyPhoto
from webapp.tasks.landmarks.mapping import (
    MATCHES_FILE,
    MappingJob,
    adjusted_folders,
    model_folders,
    run_mapper,
)
from webapp.tasks.localize.build_index import BuildRequest, describe_all
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.tags.photos import find_in_photos

SURROUNDINGS = "surroundings"
"""Folder of separately reconstructed parts of a map; a reconstruction of all photos replaces them."""

_CHOICE = FeatureChoice("sift", "sift", "l2")
_EXTRACT = ExtractSettings(max_side_px=1000, keypoints=4000)
"""More keypoints than in an index: reconstruction needs more of them than recognition, and is done once."""

_LEARNED = replace(_EXTRACT, keypoints=1500)
"""Of features for a matching network, whose time grows with the square of their number."""

_FEW = 40
"""Inliers below which a pair is also matched by the network, if one is installed."""

_LEAST_BY_NETWORK = 25
"""Inliers that a pair needs then. The network matches what looks alike more readily: 15 would do for SIFT."""


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    photos: tuple[AnyPhoto, ...]  # All photos; submodels refer to them by their number in this tuple
    submodels: tuple[Submodel, ...]  # The largest first; after `adjust_submodels`, the joined one first
    problems: Mapping[int, str]  # Why photos take no part, by their number
    folder: Path  # Folder of the submodels, with their models and points
    shared: Path  # Folder of the features and matches, which all reconstructions of the map share
    matches: Path  # The database of matches there
    # Numbers of the photos that could be read, by the SHA-256 of their files; of panoramas, by the content
    # hashes of their views.
    number_of: Mapping[str, int]
    # Degrees by which the views among them are turned clockwise from the middle of their panoramas.
    turn_of: Mapping[str, int] = field(default_factory=dict)
    altitude_of: Mapping[int, Altitude] = field(default_factory=dict)  # By the photos' numbers


def reconstruct(
    cfg: Path,
    the_map: Map,
    *,
    settings: Settings,
    progress: Progress,
    part: Path | None = None,
    wait_s: float = 0.0,
) -> Reconstruction:
    """Reconstruct the photos of a map, those in the tray included.

    Finished steps are stored at once: a killed run is resumed there, and later runs describe and match only
    new photos.

    Args:
        part: Folder for the result, if these are not all photos of the map.
        wait_s: Seconds to wait for another process that reconstructs photos of this map.

    Raises:
        MissingPart: The extra `sfm` is not installed.
    """
    folder = landmarks_folder(cfg)
    out = folder if part is None else part
    with writer_lock(folder, wait_s=wait_s):
        for name in (RIGID_FILE, SUBMODELS_FILE, CLOUD_FILE):
            remove_unfinished(out / name)
        pictures = describe_pictures(
            cfg, the_map, folder=folder, extract=_EXTRACT, settings=settings, progress=progress
        )
        described = [(one.photo, one.entry) for one in pictures.described]
        views = pictures.views
        network = _network(folder, settings)
        learned: list[Features | None] = [None] * len(described)
        if network is not None:
            request = BuildRequest(cfg, the_map, network.features, network.choice)
            learned = _describe_learned(request, pictures, settings=settings, progress=progress)
        database = MatchDatabase(folder / (MATCHES_FILE if network is None else network.matches))
        try:
            stored = _add_all(database, described, learned=learned, photo_of=views.photo)
            progress.note("finding overlapping photos")
            compare_photos(
                database,
                [(entry.content, photo) for (_, entry), photo in zip(described, stored, strict=True)],
                pairs=_pairs(described, learned, views=views),
                network=network,
                place=ExecutionTarget(settings, folder, "threads"),
                progress=progress,
            )
            contents = database.joined(dict.fromkeys(entry.content for _, entry in described))
            key = database.signature(contents)
        finally:
            database.close()
        submodels = _submodels(out, database.path, contents=contents, key=key, progress=progress)
        if part is None:
            shutil.rmtree(folder / SURROUNDINGS, ignore_errors=True)
    by_content = {entry.content: photo for photo, entry in described}
    find_in_photos(cfg, the_map, photos=by_content, folder=folder, limits=settings.photo, progress=progress)
    number_of = {one.entry.content: one.number for one in reversed(pictures.described)}
    altitudes = read_altitudes(cfg, by_content, folder=folder, limits=settings.photo, progress=progress)
    altitude_of = {number_of[content]: altitude for content, altitude in altitudes.items()}
    turn_of = {entry.content: photo.view.turn_deg for photo, entry in described if photo.view is not None}
    found = tuple(renumbered(submodels, number_of, turn_of=turn_of))
    return Reconstruction(
        pictures.photos,
        found,
        pictures.problems,
        out,
        folder,
        database.path,
        number_of,
        turn_of,
        altitude_of,
    )


class MatchingNetwork(NamedTuple):
    """The installed network that matches photos in which SIFT finds little in common."""

    choice: FeatureChoice  # The features that it matches
    features: Path  # Folder of these features
    matches: str  # File name of the database of matches: those of another network are others
    models: Path | None  # `Settings.models`

    def open(self) -> PairMatcher:
        return pair_matcher(self.choice.name, self.models)


def _network(folder: Path, settings: Settings) -> MatchingNetwork | None:
    """Return the network to match with; None if none is installed."""
    for name in usable_features(settings.models, method="thorough"):
        choice = with_weights(choose("thorough", features=name), settings.models, method="thorough")
        weights = pair_matcher(name, settings.models).weights
        features = "-".join(filter(None, ("features", name, choice.weights[:16])))
        return MatchingNetwork(choice, folder / features, f"matches-{weights}.db", settings.models)
    return None


def _describe_learned(
    request: BuildRequest, pictures: DescribedPictures, *, settings: Settings, progress: Progress
) -> list[Features | None]:
    """Describe the pictures for a matching network; None for each that could not be described."""
    photos = [one.photo for one in pictures.described]
    settings = replace(settings, extract=_LEARNED)
    entries, _ = _describe(request, photos, settings=settings, progress=progress)
    return [entries[n].features if n in entries else None for n in range(len(photos))]


class DescribedPicture(NamedTuple):
    """A photo, or a view of a panorama, with its features."""

    number: int  # Number of its photo
    photo: AnyPhoto
    entry: PhotoEntry


@dataclass(frozen=True, slots=True, eq=False)
class DescribedPictures:
    """The pictures of all photos of a map that could be read."""

    photos: tuple[AnyPhoto, ...]  # All photos, in the order in which they were taken
    described: tuple[DescribedPicture, ...]  # In the same order
    problems: Mapping[int, str]  # Why photos are not among them, by their number

    @property
    def views(self) -> Views:
        """Which photo each picture is, counted among those that could be read."""
        photo_of = np.unique([one.number for one in self.described], return_inverse=True)[1]
        turns = [-1 if (view := one.photo.view) is None else view.turn_deg for one in self.described]
        return Views(photo_of, np.array(turns, np.int64))


def describe_pictures(
    cfg: Path,
    the_map: Map,
    *,
    folder: Path,
    extract: ExtractSettings,
    settings: Settings,
    progress: Progress,
) -> DescribedPictures:
    """Describe the photos of a map, those in the tray included, unless their features are in the folder."""
    photos = _in_order(the_map)
    pictures = [(number, view) for number, photo in enumerate(photos) for view in level_views([photo])]
    entries, problems = _describe(
        BuildRequest(cfg, the_map, folder, _CHOICE),
        [view for _, view in pictures],
        settings=replace(settings, extract=extract),
        progress=progress,
    )
    # A panorama with an unreadable view takes no part: its views form one camera.
    lost = {number for n, (number, _) in enumerate(pictures) if n not in entries}
    described = (DescribedPicture(*pictures[n], entries[n]) for n in sorted(entries))
    why = {pictures[n][0]: problem for n, problem in problems.items()}
    return DescribedPictures(photos, tuple(one for one in described if one.number not in lost), why)


def _in_order(the_map: Map) -> tuple[AnyPhoto, ...]:
    """Sort photos in the order of capture: by time if all have one, else by name."""
    everyone: list[AnyPhoto] = [*the_map.experiences, *the_map.unplaced]
    everyone.sort(key=lambda photo: natural_key(photo.name or photo.photo))
    if all(photo.taken_at for photo in everyone):
        everyone.sort(key=lambda photo: str(photo.taken_at))
    return tuple(everyone)


def _position(photo: AnyPhoto) -> complex:
    return complex(*photo.position) if isinstance(photo, Experience) else complex(math.nan, math.nan)


def _describe(
    request: BuildRequest, photos: Sequence[AnyPhoto], *, settings: Settings, progress: Progress
) -> tuple[dict[int, PhotoEntry], dict[int, str]]:
    """Describe the photos; return their features, and the problems of the other photos, by number."""
    index = IndexFolder(request.folder)
    make_folder(request.folder)
    index.make_spool()
    index.remove_unfinished()
    progress.note("describing photos")
    progress.size(len(photos))
    there = {n: _described(request.cfg, one, index) for n, one in enumerate(photos)}
    entries = {n: entry for n, entry in there.items() if entry is not None}
    progress.skip(len(entries))
    nowhere = MapPixel(0.0, 0.0)
    new = [
        Experience(n, one.photo, nowhere, view=one.view, blurred=one.blurred)
        for n, one in enumerate(photos)
        if n not in entries
    ]
    problems = {}
    old = Manifest(request.choice.detector, request.choice.extractor, settings.extract)
    for done in describe_all(new, old, request=request, settings=settings, progress=progress):
        if done.error:
            problems[done.id] = done.error
        else:
            entries[done.id] = read_segment(index.spool_path(done.content)).entry(0)
        progress.advance()
    return entries, problems


def _described(cfg: Path, photo: AnyPhoto, index: IndexFolder) -> PhotoEntry | None:
    """Read the stored features of a photo; None if it has none, or cannot be read."""
    try:
        content = content_of(photo, photo_hash(cfg, photo.photo))
        return read_segment(index.spool_path(content)).entry(0)
    except (OSError, MapError, IndexDamaged):
        return None


def _add_all(
    database: MatchDatabase,
    pictures: Sequence[tuple[AnyPhoto, PhotoEntry]],
    *,
    learned: Sequence[Features | None],
    photo_of: NDArray[np.int64],
) -> list[StoredPhoto]:
    """Add photos to the database, the views of a panorama together."""
    stored: list[StoredPhoto] = []
    rows = zip(photo_of, pictures, learned, strict=True)
    for _, together in groupby(rows, key=lambda row: row[0]):
        some = [(one, entry, more) for _, (one, entry), more in together]
        views = [
            ViewFeatures(entry.content, entry.features, one.view.turn_deg, entry.fov_deg, more)
            for one, entry, more in some
            if one.view is not None
        ]
        one, entry, more = some[0]
        stored += database.add_panorama(views) if views else [_add(database, one, entry, learned=more)]
    return stored


def _add(
    database: MatchDatabase, photo: AnyPhoto, entry: PhotoEntry, *, learned: Features | None
) -> StoredPhoto:
    fov = known_fov_deg(photo, entry)
    return database.add(
        entry.content,
        entry.features,
        fov_deg=fov or guessed_fov_deg(*entry.features.photo_size),
        is_guessed=fov is None,
        learned=learned,
    )


def known_fov_deg(photo: AnyPhoto, entry: PhotoEntry) -> float | None:
    """Return the horizontal field of view that is stated for a photo or by its EXIF; None if neither is."""
    if photo.fov_deg is None and not math.isnan(entry.fov_deg):
        return entry.fov_deg
    return photo.fov_deg


def _submodels(
    folder: Path, database: Path, *, contents: Sequence[str], key: str, progress: Progress
) -> StoredSubmodels:
    """Read the stored submodels, or compute them if photos or matches have changed."""
    stored, used = (read_submodels(folder / name) for name in (RIGID_FILE, SUBMODELS_FILE))
    if stored is None or stored.key != key:
        progress.note("joining the photos")
        # if killed from here on, the former submodels must not be used with the new models
        (folder / RIGID_FILE).unlink(missing_ok=True)
        submodels = _map(folder, database, contents=contents, progress=progress)
        stored = StoredSubmodels(tuple(submodels), tuple(contents), key)
        write_submodels(folder / RIGID_FILE, stored)
    if used is None or used.key != key:
        write_submodels(folder / SUBMODELS_FILE, used := stored)
    keep_cloud(folder, used, features=database.parent)
    return stored


def keep_cloud(folder: Path, submodels: StoredSubmodels, *, features: Path) -> None:
    """Write the landmarks of the submodels, unless the stored ones are up to date."""
    file = folder / CLOUD_FILE
    there = read_cloud(file)
    if there is not None and there.key == submodels.cloud_key:
        return
    index = IndexFolder(features)

    def described(content: str) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        features = read_segment(index.spool_path(content)).entry(0).features
        return features.xy, features.descriptors

    adjusted = adjusted_folders(folder, submodels)
    cloud = read_models([*adjusted, *model_folders(folder)], submodels, described=described)
    write_cloud(file, StoredCloud(cloud, submodels.cloud_key))


def _map(folder: Path, database: Path, *, contents: Sequence[str], progress: Progress) -> list[Submodel]:
    """Run global structure from motion on all photos, then incremental on those that it left out."""
    number = {content: n for n, content in enumerate(contents)}
    submodels: list[Submodel] = []
    for is_incremental in (False, True):
        joined = {n for submodel in submodels for n in submodel.photo.tolist()}
        left = [content for content, n in number.items() if n not in joined]
        if len(left) < LEAST_PHOTOS:
            break
        job = MappingJob(database, folder, tuple(left), is_incremental)
        for model in run_mapper(job, progress=progress):
            for part in model.parts():
                numbers = np.array([number[model.contents[i]] for i in part], np.int64)
                submodels.append(Submodel(numbers, model.centre[part], model.rotation[part]))
    return sorted(submodels, key=len, reverse=True)


def renumbered(
    stored: StoredSubmodels, number_of: Mapping[str, int], *, turn_of: Mapping[str, int]
) -> Iterator[Submodel]:
    """Yield submodels with the current numbers of the photos; a panorama becomes one camera."""
    numbers = np.array([number_of[content] for content in stored.contents], np.int64)
    turns = np.array([turn_of.get(content, 0) for content in stored.contents], np.int64)
    for submodel in stored.submodels:
        yield of_photos(submodel, photo=numbers[submodel.photo], turn_deg=turns[submodel.photo])


_HELD = 64
"""Photos that a worker keeps in memory: those of neighbouring pairs."""


class _Sources(NamedTuple):
    """What a Dask worker needs to compare photos."""

    folder: Path  # Of their features
    contents: tuple[str, ...]  # SHA-256 of the photos
    cameras: tuple[tuple[int, Any], ...]  # Ids in the database, and cameras
    network: MatchingNetwork | None

    def photo(self, number: int) -> StoredPhoto:
        """Read a photo's features."""
        content = self.contents[number]
        learned = None if self.network is None else _features(self.network.features, content)
        return stored_photo(*self.cameras[number], features=_features(self.folder, content), learned=learned)


def _features(folder: Path, content: str) -> Features:
    return read_segment(IndexFolder(folder).spool_path(content), mapped=False).entry(0).features


class ComparedPhotos:
    """The photos to compare; a Dask worker reads their features from files."""

    def __init__(self, sources: _Sources, photos: Sequence[StoredPhoto] | None = None) -> None:
        self._sources = sources
        self.network = sources.network
        self.photo = lru_cache(_HELD)(sources.photo) if photos is None else photos.__getitem__

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the photos in memory."""
        return ComparedPhotos, (self._sources,)


def _pairs(
    described: Sequence[tuple[AnyPhoto, PhotoEntry]], learned: Sequence[Features | None], *, views: Views
) -> Pairs:
    """Choose the pairs to match, by SIFT and, if there are some, by the network's features."""
    at = np.array([_position(photo) for photo, _ in described], np.complex128)
    pairs = choose_pairs([entry.features.descriptors for _, entry in described], at=at, views=views)
    known = [one.descriptors for one in learned if one is not None]
    if not known:
        return pairs
    more = [known[0][:0] if one is None else one.descriptors for one in learned]
    return np.unique(np.concatenate([pairs, choose_pairs(more, at=at, views=views)]), axis=0)


def compare_photos(
    database: MatchDatabase,
    photos: Sequence[tuple[str, StoredPhoto]],
    *,
    pairs: Pairs,
    network: MatchingNetwork | None,
    place: ExecutionTarget,
    progress: Progress,
) -> None:
    """Match those of the pairs that have not been matched yet.

    Raises Cancelled, ProcessLost, ClusterUnavailable, UsageError, MissingPart.

    Args:
        network: Matches the pairs in which SIFT finds little.
        place: Its folder is that of the features.
    """
    stored = [photo for _, photo in photos]
    new = [
        (one, other) for one, other in pairs.tolist() if not database.is_compared(stored[one], stored[other])
    ]
    progress.note("matching the photos")
    progress.size(len(new))
    cameras = tuple((photo.id, photo.camera) for photo in stored)
    sources = _Sources(place.folder.absolute(), tuple(content for content, _ in photos), cameras, network)
    shared = ComparedPhotos(sources, stored)
    found = in_order(_compare, new, shared=shared, at=place, progress=progress)
    for (one, other), geometry in zip(new, found, strict=True):
        database.keep(stored[one], stored[other], geometry=geometry)
        progress.advance()


def _compare(photos: ComparedPhotos, pair: tuple[int, int]) -> Any:
    one, other = map(photos.photo, pair)
    matches = match_mutually(one.descriptors, other.descriptors)
    geometry = two_view_geometry(one, other, matches=matches)
    if photos.network is None or one.learned is None or other.learned is None:
        return geometry
    if len(geometry.inlier_matches) >= _FEW:
        return geometry
    found = photos.network.open().match(one.learned, other.learned)
    rows = (found + np.array([len(one.descriptors), len(other.descriptors)])).astype(np.uint32)
    both = two_view_geometry(one, other, matches=np.concatenate([matches, rows]))
    return both if len(both.inlier_matches) >= _LEAST_BY_NETWORK else geometry
