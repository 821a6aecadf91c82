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
from typing import NamedTuple

from webapp.errors import BeingOpened, IndexDamaged, InputError, MapError, MissingPart, NotFound, NotReady
from webapp.files.contents import facts_of
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.localize.models import global_model_paths, usable_global_descriptor
from webapp.files.part_file import show_file_as
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.on_demand import LandmarksAround
from webapp.tasks.localize import calibrate, cascade, describe_photos, geometry, orient_map
from webapp.tasks.localize.open_index import open_index, with_positions
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.open_pipeline import make_plan, stored_look
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look, TaggedMap
from webapp.tasks.localize.plan import LookPlan, MapPlan, OpenOptions
from webapp.tasks.maps.library_map import as_map
from webapp.tasks.tags.answer import has_tags

MAX_OPEN = 12
"""Maximum number of open indexes, two for a map with a second look; the least recently used are evicted."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenedMap:
    """A map that is open for localization."""

    pipeline: LocalizationPipeline
    revision: int  # Revision of the map's photos and positions
    not_indexed: int  # Number of the map's photos that are not in the index yet
    calibrated: bool  # False while it uses the default calibration
    to_calibrate: bool  # Whether it has no calibration, or has changed much since it was calibrated


_OPEN_WAIT_S = 10.0
"""Seconds to wait while another request opens the map; short, as each waiting request occupies a thread."""

_Files = tuple[tuple[int, int] | None, ...]


class _OpenLook(NamedTuple):
    """As `StoredLook`, and as `OpenedMap`."""

    look: Look
    to_calibrate: bool
    revision: int
    not_indexed: int


@dataclass(slots=True, eq=False)
class _Slot:
    """Cache entry of a look on a map; the lock is held while it is opened."""

    lock: Lock = field(default_factory=Lock)
    ready: _OpenLook | None = None
    opened_with: _Files = ()
    """Times and sizes of the files that the open map was read from, see `MapCache._files`."""


class MapCache:
    """LRU cache of open maps of a library.

    Args:
        most: Maximum number of entries.
        on_look: Called at each look-up with True for a hit, False for a miss.
    """

    def __init__(
        self,
        library: Library,
        settings: Settings,
        *,
        most: int = MAX_OPEN,
        on_look: Callable[[bool], None] = lambda _: None,
    ) -> None:
        self.library = library
        self.settings = settings
        self._most = most
        self._on_look = on_look
        self._slots: OrderedDict[tuple[int, LookPlan], _Slot] = OrderedDict()
        self._lock = Lock()

    def get(self, map_id: int, options: OpenOptions) -> OpenedMap:
        """Return the current state of a map; concurrent requests open it only once.

        Raises:
            NotReady: It has no index with these features yet.
            BeingOpened: Another request is still opening it.
            MapError: It has no image, no photo, or no photo with features.
            UsageError: The features do not exist or do not work with this method.
            NotFound: The map is gone.
            IndexDamaged
        """
        plan = make_plan(self._cfg(map_id), replace(options, build=False), settings=self.settings)
        try:
            first = self._look(map_id, plan.looks[0])
        except MapError:
            of_tags = self._of_tags_alone(map_id, plan)
            if of_tags is None:
                raise
            return of_tags
        look = first.look
        if plan.landmarks_on_demand:
            look = replace(look, around=LandmarksAround(self.settings, Progress(), build=False))
        opened = OpenedMap(
            LocalizationPipeline(plan.method, (look,)),
            revision=first.revision,
            not_indexed=first.not_indexed,
            calibrated=look.calibration is not None or look.opened.method == "vote",
            to_calibrate=first.to_calibrate,
        )
        if len(plan.looks) == 1:
            return opened
        try:
            further = self._look(map_id, plan.looks[1].with_kind_of(look.opened.indexed.kind))
        except (NotReady, IndexDamaged):
            return replace(opened, to_calibrate=True)  # answer with one look while the second is built
        except (BeingOpened, MapError, MissingPart, InputError):
            return opened  # it is being opened; or `expmap build` reports the reason
        return _with_second_look(opened, further, budget_s=plan.budget_s)

    def _of_tags_alone(self, map_id: int, plan: MapPlan) -> OpenedMap | None:
        """Open a map that has tags and no photos; None for any other map."""
        with self.library.database.read() as session:
            record = session.get(MapRecord, map_id)
            the_map = None if record is None else as_map(session, record)
        if the_map is None or the_map.experiences or not has_tags(the_map):
            return None
        tagged = TaggedMap(self._cfg(map_id), the_map, self.settings)
        pipeline = LocalizationPipeline(plan.method, (), tags_alone=tagged)
        return OpenedMap(pipeline, the_map.revision, 0, calibrated=True, to_calibrate=False)

    def _cfg(self, map_id: int) -> Path:
        with self.library.database.read() as session:
            record = session.get(MapRecord, map_id)
            if record is None:
                raise NotFound("the map was deleted")
            return self.library.cfg(record.slug)

    def _look(self, map_id: int, plan: LookPlan) -> _OpenLook:
        slot = self._slot((map_id, plan))
        if not slot.lock.acquire(timeout=_OPEN_WAIT_S):  # opening a large map from S3 may take minutes
            raise BeingOpened("the map is being opened", wait_s=5, hint="try again in a moment")
        try:
            slot.ready = self._current(slot, map_id, plan)
            return slot.ready
        except (MapError, NotReady, NotFound):
            slot.ready = None
            raise
        finally:
            slot.lock.release()

    def _slot(self, key: tuple[int, LookPlan]) -> _Slot:
        with self._lock:
            slot = self._slots.setdefault(key, _Slot())
            self._slots.move_to_end(key)
            while len(self._slots) > self._most:
                self._slots.popitem(last=False)
            return slot

    def _current(self, slot: _Slot, map_id: int, plan: LookPlan) -> _OpenLook:
        there = slot.ready
        with self.library.database.read() as session:
            record = session.get(MapRecord, map_id)
            if record is None:
                raise NotFound("the map was deleted")
            cfg, revision = self.library.cfg(record.slug), record.revision
            same_index = there is not None and slot.opened_with == self._files(there.look.opened)
            is_open = there is not None and same_index and there.revision == revision
            self._on_look(is_open)
            if there is not None and is_open:
                return there
            the_map = as_map(session, record)
        if the_map is None:
            raise MapError("the map has no satellite image yet", hint="add one, and place photos on it")
        with show_file_as(cfg.parent.name, cfg):
            if there is not None and same_index:
                opened = with_positions(there.look.opened, the_map)
            else:
                opened = open_index(cfg, plan, the_map=the_map, settings=self.settings, progress=Progress())
            # Record this before reading the calibration: a newer one, or a newer index, is noticed next time.
            slot.opened_with = self._files(opened)
            if opened.folder.read_manifest() != opened.manifest:
                slot.opened_with = ()
            return _OpenLook(*stored_look(opened), the_map.revision, opened.not_indexed)

    def _files(self, opened: OpenMap) -> _Files:
        """Return size and time of the files that an open map depends on."""
        files = [opened.folder.manifest_path, *calibrate.paths_with(opened, None), *orient_map.paths(opened)]
        files += [*geometry.paths(opened), *global_model_paths(self.settings.models)]
        network = usable_global_descriptor(self.settings.models)
        if network is not None:
            files += (*calibrate.paths_with(opened, network), *describe_photos.paths(opened, network))
        return tuple(facts_of(path) for path in files)


def _with_second_look(first: OpenedMap, second: _OpenLook, *, budget_s: float) -> OpenedMap:
    """Add the second look to a map, if it is within the time budget and both looks are calibrated."""
    pair = first.pipeline.looks[0], second.look
    joined = cascade.join_looks(pair, budget_s=budget_s, calibrated=_stored_looks)
    outdated = joined.both is not None and not cascade.still_fits(joined.both, pair)
    return replace(
        first,
        pipeline=replace(first.pipeline, looks=joined.looks, both=joined.calibration),
        to_calibrate=first.to_calibrate or second.to_calibrate or joined.is_uncalibrated or outdated,
        not_indexed=max(first.not_indexed, second.not_indexed),
    )


def _stored_looks(pair: cascade.Pair) -> StoredCalibration | None:
    path = cascade.path(*(look.opened for look in pair))
    return _stored(path, facts_of(path))


@lru_cache(maxsize=MAX_OPEN)
def _stored(path: Path, seen: tuple[int, int] | None) -> StoredCalibration | None:
    """Read the calibration of two looks; cached until the file changes."""
    return cascade.stored_looks(path) if seen is not None else None
