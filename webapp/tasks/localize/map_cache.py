"""Maps of the library kept open, so that a photo is localized at once; one cache a process.

What is large of an index is memory-mapped and shared by all processes, but for compressed codes.
Places come from the records: a photo that was moved counts where it is now, and a new index is taken as
soon as it is there.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

from webapp.core.features.table import METHODS, Method, choose
from webapp.core.mapmodel.model import Map
from webapp.errors import MapError, NotFound, NotReady, UsageError
from webapp.files.part_file import show_file_as
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.localize import calibrate, open_map, orient_map
from webapp.tasks.localize.open_map import OpenMap, OpenOptions
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.maps.library_map import as_map

MAX_OPEN = 8
"""Maps, each with its method and features; one that is asked rarely is opened again."""


@dataclass(frozen=True, slots=True)
class MethodChoice:
    """Method and features to localize with.

    Attributes
    ----------
    method : str
        `vote`, `verified` or `thorough`.
    features : str
        Of the index to use; `auto` for those that the library's own index has.
    """

    method: str = "verified"
    features: str = "auto"

    def resolved(self) -> tuple[Method, str]:
        """Return method and features that fit each other.

        Raises
        ------
        UsageError
        """
        method = next((m for m in METHODS if m == self.method), None)
        if method is None:
            hint = f"known: {', '.join(METHODS)}"
            raise UsageError(f"unknown method {self.method!r}", where="method", hint=hint)
        return method, choose(method, features=self.features).name


@dataclass(frozen=True, slots=True, eq=False)
class OpenedMap:
    """A map that answers at once.

    Attributes
    ----------
    revision : int
        Of the places it has.
    not_indexed : int
        Photos of the map that cannot be found yet.
    calibrated : bool
        False while its probabilities are those of most maps.
    to_calibrate : bool
        Whether it has no calibration, or has changed much since.
    """

    pipeline: LocalizationPipeline
    revision: int
    not_indexed: int
    calibrated: bool
    to_calibrate: bool


_Files = tuple[tuple[int, int] | None, ...]


@dataclass(slots=True, eq=False)
class _Slot:
    """A map's place in the cache; whoever opens it holds the lock."""

    lock: Lock = field(default_factory=Lock)
    ready: OpenedMap | None = None
    opened_with: _Files = ()
    """Times and sizes of the manifest, the calibration and the orientations."""


class MapCache:
    """Open maps of a library, the ones that were asked last.

    Parameters
    ----------
    most : int
        So many are kept open.
    """

    def __init__(self, library: Library, settings: Settings, *, most: int = MAX_OPEN) -> None:
        self._library = library
        self._settings = settings
        self._most = most
        self._slots: OrderedDict[tuple[int, Method, str], _Slot] = OrderedDict()
        self._lock = Lock()

    def get(self, map_id: int, choice: MethodChoice) -> OpenedMap:
        """Give a map as it is now; opened by one at a time, however many ask.

        Raises
        ------
        NotReady
            It has no index with these features yet.
        MapError
            It has no image, no photo, or none with anything to recognise it by.
        UsageError
            The features do not exist, or not for this method.
        NotFound
            The map is gone.
        IndexDamaged
        """
        method, features = choice.resolved()
        options = OpenOptions(method=method, features=features, build=False)
        slot = self._slot((map_id, method, features))
        with slot.lock:
            try:
                slot.ready = self._current(slot, map_id, options)
            except (MapError, NotReady, NotFound):
                slot.ready = None
                raise
            return slot.ready

    def _slot(self, key: tuple[int, Method, str]) -> _Slot:
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
                raise NotFound("the map is gone")
            cfg, revision = self._library.cfg(record.slug), record.revision
            same_index = there is not None and slot.opened_with == _files(there.pipeline.opened)
            if there is not None and same_index and there.revision == revision:
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
        # Looked at before the calibration is read: a newer one is noticed the next time, as is a newer index.
        slot.opened_with = _files(opened)
        if opened.folder.read_manifest() != opened.manifest:
            slot.opened_with = ()
        verifies = opened.method != "vote"
        if verifies:
            opened = orient_map.with_orientations(opened, orient_map.newest(opened))
        stored = calibrate.newest(opened) if verifies else None
        return OpenedMap(
            LocalizationPipeline(opened, self._settings, stored),
            revision=the_map.revision,
            not_indexed=opened.not_indexed,
            calibrated=stored is not None or not verifies,
            to_calibrate=verifies
            and (stored is None or not calibrate.still_fits(stored, opened, map_fov_deg=options.map_fov_deg)),
        )


def _files(opened: OpenMap) -> _Files:
    """Tell what the files look like that an open map depends on."""
    return tuple(_look(path) for path in _paths(opened))


def _paths(opened: OpenMap) -> tuple[Path, ...]:
    return (opened.folder.manifest_path, *calibrate.paths(opened), *orient_map.paths(opened))


def _look(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_mtime_ns, found.st_size
