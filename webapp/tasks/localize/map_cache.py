"""Maps of the library kept open, so that a photo is localized at once; one cache a process.

What is large of an index is memory-mapped and shared by all processes, but for compressed codes.
Places come from the records: a photo that was moved counts where it is now, and a new index is taken as
soon as it is there.
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
"""Indexes of maps, two for a map with a second look; one that is asked rarely is opened again."""


@dataclass(frozen=True, slots=True)
class MethodChoice:
    """Method and features to localize with.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    features : str
        Of the index to use; `auto` for those that the library's own index has.
    """

    method: str = "auto"
    features: str = "auto"

    def resolved(self) -> tuple[Method, str]:
        """Return method and features that fit each other; of both `auto` the features stay so, too.

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


_OPEN_WAIT_S = 10.0
"""Seconds to wait while another request opens the map: each that waits holds a thread."""

_Files = tuple[tuple[int, int] | None, ...]


@dataclass(slots=True, eq=False)
class _Slot:
    """A map's place in the cache; whoever opens it holds the lock."""

    lock: Lock = field(default_factory=Lock)
    ready: OpenedMap | None = None
    opened_with: _Files = ()
    """Times and sizes of the manifest, the calibration, the orientations and the global descriptors."""


class MapCache:
    """Open maps of a library, the ones that were asked last.

    Parameters
    ----------
    most : int
        Maximum number kept open.
    on_look : callable
        Called with whether a map was open already.
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
        """Give a map as it is now; opened by one at a time, however many ask.

        Raises
        ------
        NotReady
            It has no index with these features yet.
        BeingOpened
            Another request is opening it, and that takes long.
        MapError
            It has no image, no photo, or none with anything to recognise it by.
        UsageError
            The features do not exist, or not for this method.
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
            second = cascade.of_one_kind(further[0], opened.pipeline.opened)
            return _with_second_look(opened, self._get_look(map_id, second))
        except (NotReady, IndexDamaged):
            return replace(opened, to_calibrate=True)  # it is built meanwhile, and one look answers
        except BeingOpened:
            return opened  # until it is open, one look answers
        except (MapError, MissingPart, InputError):
            return opened  # `expmap build` says why

    def _cfg(self, map_id: int) -> Path:
        with self._library.database.read() as session:
            record = session.get(MapRecord, map_id)
            if record is None:
                raise NotFound("the map is gone")
            return self._library.cfg(record.slug)

    def _get_look(self, map_id: int, options: OpenOptions) -> OpenedMap:
        choice = options.choice()  # so that an index is open once, however its features were asked for
        options = replace(options, features="auto", detector=choice.detector, extractor=choice.extractor)
        slot = self._slot((map_id, options))
        if not slot.lock.acquire(timeout=_OPEN_WAIT_S):  # from S3, a large map may take minutes
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
                raise NotFound("the map is gone")
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
        # Looked at before the calibration is read: a newer one is noticed the next time, as is a newer index.
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
        """Attach global descriptors once the map is calibrated with them; returns whether that is to do."""
        network = usable_global_descriptor(self._settings.models)
        if network is None:
            return opened, False
        described = describe_photos.with_stored_vectors(opened, network)
        ready = described is not opened and calibrate.newest(described) is not None
        return (described, False) if ready else (opened, True)

    def _files(self, opened: OpenMap) -> _Files:
        """Read size and time of the files that an open map depends on."""
        files = [opened.folder.manifest_path, *calibrate.paths_with(opened, None), *orient_map.paths(opened)]
        files += [*geometry.paths(opened), *model_paths(self._settings.models)]
        network = usable_global_descriptor(self._settings.models)
        if network is not None:
            files += (*calibrate.paths_with(opened, network), *describe_photos.paths(opened, network))
        return tuple(facts_of(path) for path in files)


def _with_second_look(first: OpenedMap, second: OpenedMap) -> OpenedMap:
    """Add a second look to a map, where there is time for it and both are calibrated."""
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
    """Read the calibration of two looks, again only when the file has changed."""
    return cascade.stored_looks(path) if seen is not None else None
