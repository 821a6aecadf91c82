"""Opens a map on a worker of Dask as it is open here: from the same files, once for all parts."""

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
from webapp.tasks.localize.open_map import OpenMap, OpenOptions, open_index

Value = TypeVar("Value")


class MadeAgain(Generic[Value]):
    """A value that is not sent to other processes: they make it again.

    Parameters
    ----------
    make : callable
        Makes it; what is sent.
    value : object, optional
        Where it is there already.
    """

    def __init__(self, make: Callable[[], Value], value: Value | None = None) -> None:
        self._make = make
        self._value = value
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[object, ...]:
        """Leave the value behind."""
        return MadeAgain, (self._make,)

    def value(self) -> Value:
        """Return the value; the first call in a process makes it."""
        with self._lock:
            if self._value is None:
                self._value = self._make()
            return self._value


@dataclass(frozen=True, slots=True)
class MapFiles:
    """What an open map is opened from.

    Attributes
    ----------
    options : OpenOptions
        With the features that it was opened with.
    map_hash : str
        Of the open map.
    """

    cfg: Path
    the_map: Map
    options: OpenOptions
    settings: Settings
    map_hash: str
    has_global_descriptors: bool

    @classmethod
    def of(cls, opened: OpenMap) -> MapFiles:
        """Find them for a map that is open."""
        choice = opened.choice
        options = replace(
            opened.options,
            detector=choice.detector,
            extractor=choice.extractor,
            matcher=choice.matcher,
            build=False,
        )
        return cls(
            opened.cfg.absolute(),
            opened.map,
            options,
            replace(opened.settings, dask=None),
            opened.map_hash,
            opened.indexed.global_descriptors is not None,
        )

    def open(self) -> OpenMap:
        """Open the map, without its geometry.

        Raises
        ------
        Conflict
            Its index has become another one.
        MissingPart, InputError, StorageError, IndexDamaged
        """
        opened = open_index(
            self.cfg, self.options, settings=self.settings, progress=Progress(), the_map=self.the_map
        )
        network = global_descriptor(self.settings.models) if self.has_global_descriptors else None
        if network is not None:
            opened = describe_photos.with_stored_vectors(opened, network)
        if opened.map_hash != self.map_hash:
            raise Conflict(
                "the index of the map was changed meanwhile", where=str(self.cfg), hint="start again"
            )
        return opened
