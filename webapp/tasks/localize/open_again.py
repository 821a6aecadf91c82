"""Opens a map again in another process, from the same files and once for all parts of the work."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from webapp.core.mapmodel.model import Map
from webapp.errors import Conflict
from webapp.files.localize.global_model import global_descriptor
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import describe_photos
from webapp.tasks.localize.open_index import open_index
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.plan import LookPlan

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
