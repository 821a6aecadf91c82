"""Keeps maps of the library open, so that photos are localized without delay; one cache per process.

The large files of an index are memory-mapped and shared by all processes, except compressed codes.
Positions are read from the database, so that a moved photo takes effect at once, and a new index is used as
soon as it is written.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from threading import Lock

from webapp.core.features.table import METHODS, Method, choose
from webapp.core.mapmodel.model import Map
from webapp.errors import (
    BeingOpened,
    IndexDamaged,
    InputError,
    MapError,
    MissingPart,
    NotFound,
    NotReady,
    UsageError,
)
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.localize.global_model import model_paths, usable_global_descriptor
from webapp.files.object_storage.storage import facts_of
from webapp.files.part_file import show_file_as
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.on_demand import LandmarksAround, options_for_retrieval
from webapp.tasks.localize import calibrate, cascade, describe_photos, geometry, open_map, orient_map
from webapp.tasks.localize.open_map import OpenMap, OpenOptions
from webapp.tasks.localize.pipeline import LocalizationPipeline, join_looks
from webapp.tasks.maps.library_map import as_map

MAX_OPEN = 12
"""Maximum number of open indexes, two for a map with a second look; the least recently used are evicted."""


@dataclass(frozen=True, slots=True)
class MethodChoice:
    """Method and features to localize with.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    features : str
        Features of the index to use; `auto` for those of the library's default index.
    """

    method: str = "auto"
    features: str = "auto"

    def resolved(self) -> tuple[Method, str]:
        """Return compatible method and features; if both are `auto`, the features stay `auto`.

        Raises
        ------
        UsageError
        """
        method = next((m for m in METHODS if m == self.method), None)
        if method is None:
            hint = f"known: {', '.join(METHODS)}"
            raise UsageError(f"unknown method {self.method!r}", where="method", hint=hint)
        features = choose(method, features=self.features).name
        return method, "auto" if method == "auto" and self.features == "auto" else features


@dataclass(frozen=True, slots=True, eq=False)
class OpenedMap:
    """A map that is open for localization.

    Attributes
    ----------
    revision : int
        Revision of the map's photos and positions.
    not_indexed : int
        Number of the map's photos that are not in the index yet.
    calibrated : bool
        False while it uses the default calibration.
    to_calibrate : bool
        Whether it has no calibration, or has changed much since it was calibrated.
    """

    pipeline: LocalizationPipeline
    revision: int
    not_indexed: int
    calibrated: bool
    to_calibrate: bool


_OPEN_WAIT_S = 10.0
"""Seconds to wait while another request opens the map; short, as each waiting request occupies a thread."""

_Files = tuple[tuple[int, int] | None, ...]


@dataclass(slots=True, eq=False)
class _Slot:
    """Cache entry of a map; the lock is held while it is opened."""

    lock: Lock = field(default_factory=Lock)
    ready: OpenedMap | None = None
    opened_with: _Files = ()
    """Times and sizes of the files that the open map was read from, see `MapCache._files`."""


class MapCache:
    """LRU cache of open maps of a library.

    Parameters
    ----------
    most : int
        Maximum number of entries.
    on_look : callable
        Called at each look-up with True for a hit, False for a miss.
    """

    def __init__(
        self,
        library: Library,
        settings: Settings,
        *,
        most: int = MAX_OPEN,
        on_look: Callable[[bool], None] = lambda _: None,
    ) -> None:
        self._library = library
        self._settings = settings
        self._most = most
        self._on_look = on_look
        self._slots: OrderedDict[tuple[int, OpenOptions], _Slot] = OrderedDict()
        self._lock = Lock()

    def get(self, map_id: int, choice: MethodChoice) -> OpenedMap:
        """Return the current state of a map; concurrent requests open it only once.

        Raises
        ------
        NotReady
            It has no index with these features yet.
        BeingOpened
            Another request is still opening it.
        MapError
            It has no image, no photo, or no photo with features.
        UsageError
            The features do not exist or do not work with this method.
        NotFound
            The map is gone.
        IndexDamaged
        """
        method, features = choice.resolved()
        asked = OpenOptions(method=method, features=features, build=False)
        asked = options_for_retrieval(self._cfg(map_id), asked, settings=self._settings)
        around = None if asked.method == method else LandmarksAround(self._settings, Progress(), build=False)
        first, *further = cascade.look_options(asked, first=choose("verified"), settings=self._settings)
        opened = self._get_look(map_id, first)
        opened = replace(opened, pipeline=replace(opened.pipeline, asked=method, around=around))
        if not further:
            return opened
        try:
            second = cascade.with_same_kind(further[0], opened.pipeline.opened)
            return _with_second_look(opened, self._get_look(map_id, second))
        except (NotReady, IndexDamaged):
            return replace(opened, to_calibrate=True)  # answer with one look while the second is built
        except BeingOpened:
            return opened  # answer with one look until the second is open
        except (MapError, MissingPart, InputError):
            return opened  # `expmap build` reports the reason

    def _cfg(self, map_id: int) -> Path:
        with self._library.database.read() as session:
            record = session.get(MapRecord, map_id)
            if record is None:
                raise NotFound("the map was deleted")
            return self._library.cfg(record.slug)

    def _get_look(self, map_id: int, options: OpenOptions) -> OpenedMap:
        choice = options.choice()  # one cache key per index, however its features were requested
        options = replace(options, features="auto", detector=choice.detector, extractor=choice.extractor)
        slot = self._slot((map_id, options))
        if not slot.lock.acquire(timeout=_OPEN_WAIT_S):  # opening a large map from S3 may take minutes
            raise BeingOpened("the map is being opened", wait_s=5, hint="try again in a moment")
        try:
            slot.ready = self._current(slot, map_id, options)
            return slot.ready
        except (MapError, NotReady, NotFound):
            slot.ready = None
            raise
        finally:
            slot.lock.release()

    def _slot(self, key: tuple[int, OpenOptions]) -> _Slot:
        with self._lock:
            slot = self._slots.setdefault(key, _Slot())
            self._slots.move_to_end(key)
            while len(self._slots) > self._most:
                self._slots.popitem(last=False)
            return slot

    def _current(self, slot: _Slot, map_id: int, options: OpenOptions) -> OpenedMap:
        there = slot.ready
        with self._library.database.read() as session:
            record = session.get(MapRecord, map_id)
            if record is None:
                raise NotFound("the map was deleted")
            cfg, revision = self._library.cfg(record.slug), record.revision
            same_index = there is not None and slot.opened_with == self._files(there.pipeline.opened)
            is_open = there is not None and same_index and there.revision == revision
            self._on_look(is_open)
            if there is not None and is_open:
                return there
            the_map = as_map(session, record)
        if the_map is None:
            raise MapError("the map has no satellite image yet", hint="add one, and place photos on it")
        opened = there.pipeline.opened if there is not None and same_index else None
        with show_file_as(cfg.parent.name, cfg):
            return self._open(slot, cfg, the_map, options=options, opened=opened)

    def _open(
        self, slot: _Slot, cfg: Path, the_map: Map, *, options: OpenOptions, opened: OpenMap | None
    ) -> OpenedMap:
        if opened is None:
            opened = open_map.open_index(
                cfg, options, settings=self._settings, progress=Progress(), the_map=the_map
            )
        else:
            opened = open_map.with_positions(opened, the_map, options=options)
        # Record this before reading the calibration: a newer one, or a newer index, is noticed next time.
        slot.opened_with = self._files(opened)
        if opened.folder.read_manifest() != opened.manifest:
            slot.opened_with = ()
        verifies = opened.method != "vote"
        if verifies:
            opened = geometry.with_stored_geometry(opened)
        opened, undescribed = self._described(opened) if verifies else (opened, False)
        stored = calibrate.newest(opened) if verifies else None
        return OpenedMap(
            LocalizationPipeline(opened, self._settings, stored),
            revision=the_map.revision,
            not_indexed=opened.not_indexed,
            calibrated=stored is not None or not verifies,
            to_calibrate=undescribed
            or (verifies and stored is None)
            or (
                stored is not None
                and not calibrate.still_fits(stored, opened, map_fov_deg=options.map_fov_deg)
            ),
        )

    def _described(self, opened: OpenMap) -> tuple[OpenMap, bool]:
        """Attach global descriptors if the map is calibrated with them; return whether that is still due."""
        network = usable_global_descriptor(self._settings.models)
        if network is None:
            return opened, False
        described = describe_photos.with_stored_vectors(opened, network)
        ready = described is not opened and calibrate.newest(described) is not None
        return (described, False) if ready else (opened, True)

    def _files(self, opened: OpenMap) -> _Files:
        """Return size and time of the files that an open map depends on."""
        files = [opened.folder.manifest_path, *calibrate.paths_with(opened, None), *orient_map.paths(opened)]
        files += [*geometry.paths(opened), *model_paths(self._settings.models)]
        network = usable_global_descriptor(self._settings.models)
        if network is not None:
            files += (*calibrate.paths_with(opened, network), *describe_photos.paths(opened, network))
        return tuple(facts_of(path) for path in files)


def _with_second_look(first: OpenedMap, second: OpenedMap) -> OpenedMap:
    """Add the second look to a map, if it is within the time budget and both looks are calibrated."""
    pipeline, further = first.pipeline, second.pipeline
    opened = (pipeline.opened, further.opened)
    not_indexed = max(first.not_indexed, second.not_indexed)
    to_calibrate = first.to_calibrate or second.to_calibrate
    if pipeline.calibration is None or further.calibration is None or not cascade.share_areas(*opened):
        return replace(first, to_calibrate=to_calibrate, not_indexed=not_indexed)
    path = cascade.path(*opened)
    both = _stored_looks(path, facts_of(path))
    if both is None or not cascade.is_within_budget(both, pipeline.settings):
        to_calibrate = to_calibrate or both is None
        return replace(first, to_calibrate=to_calibrate, not_indexed=not_indexed)
    calibrations = cascade.agree_on_scale(pipeline.calibration.calibration, further.calibration.calibration)
    return replace(
        first,
        pipeline=join_looks(pipeline, further, calibrations=calibrations, both=both.calibration),
        to_calibrate=to_calibrate or not cascade.still_fits(both, opened),
        not_indexed=not_indexed,
    )


@lru_cache(maxsize=MAX_OPEN)
def _stored_looks(path: Path, seen: tuple[int, int] | None) -> StoredCalibration | None:
    """Read the calibration of two looks; cached until the file changes."""
    return cascade.stored_looks(path) if seen is not None else None
