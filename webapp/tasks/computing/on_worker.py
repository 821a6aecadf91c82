"""What a worker of Dask does with a part of some work: checks itself, then calls the function.

The scheduler imports this module too, so that it imports nothing heavy itself.
"""

from __future__ import annotations

import pickle
import platform
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any

from webapp import __version__
from webapp.errors import UsageError
from webapp.extras import extra
from webapp.logs import Carried, Form, at_work, log_to_stderr
from webapp.settings import Settings, keep_freed_memory
from webapp.telemetry import start as start_telemetry
from webapp.threads import cores

_DECIDE = (
    "numpy",
    "opencv-python-headless",
    "faiss-cpu",
    "poselib",
    "pillow",
    "pillow-heif",
    "onnxruntime",
    "pycolmap",
    "distributed",
)
"""Distributions whose versions decide the results, or whether machines understand each other."""

_LOCK = threading.Lock()


@cache
def versions() -> Mapping[str, str]:
    """Give the versions of what decides the results; an empty one of what is not installed."""
    found = {"experience-map": __version__, "Python": ".".join(platform.python_version_tuple()[:2])}
    for name in _DECIDE:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return MappingProxyType(found)


@dataclass(frozen=True, slots=True)
class Terms:
    """Under what conditions a worker does a part.

    Attributes
    ----------
    versions : mapping of str to str
        Of the process that asks.
    marker : Path
        A file that is there as long as the result is wanted, in the folder that the parts need.
    log : Carried
        What lines of the log carry, as in the process that asks.
    """

    versions: Mapping[str, str]
    marker: Path
    settings: Settings
    log: Carried

    def check(self, worker: str) -> None:
        """Refuse work that would come out differently here.

        Raises
        ------
        UsageError
        """
        own = versions()
        other = [n for n, v in self.versions.items() if own.get(n) != v]
        if other:
            name = other[0]
            raise UsageError(
                f"the Dask worker {worker} has {name} {own.get(name) or '(not installed)'}, "
                f"this process {self.versions[name] or '(not installed)'}",
                where="EXPMAP_DASK",
                hint="install the same versions on all machines: pip install -c constraints.txt; "
                "see docs/cluster.md",
            )
        if not self.marker.exists():
            raise UsageError(
                f"the Dask worker {worker} cannot see the folder {self.marker.parent}",
                where="EXPMAP_DASK",
                hint="mount it there at the same path; see docs/cluster.md",
            )


class SharedValue:
    """What all parts share, in a worker's memory; it is unpickled there once."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._value: Any = None
        self._is_there = False
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the bytes, not the value that was made of them."""
        return SharedValue, (self._data,)

    def value(self) -> Any:
        """Return the value."""
        with self._lock:
            if not self._is_there:
                self._value, self._is_there = pickle.loads(self._data), True
            return self._value


def keep(data: bytes) -> SharedValue:
    """Keep what all parts share in the memory of a worker."""
    return SharedValue(data)


def do(part: bytes, shared: SharedValue, *, terms: bytes, native_threads: int) -> Any:
    """Do a part.

    Parameters
    ----------
    part : bytes
        The function and the item, pickled, so that the scheduler need not understand them.
    shared : SharedValue
        First argument of the function.
    terms : bytes
        `Terms`, pickled.
    native_threads : int
        That Faiss may use for it, up to the cores of this machine.

    Raises
    ------
    UsageError
        This worker is another one than the work needs.
    """
    with extra("cluster"):
        from distributed import get_worker

    address = get_worker().address
    try:
        agreed: Terms = pickle.loads(terms)
        agreed.check(address)
        function, item = pickle.loads(part)
        value = shared.value()
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"the Dask worker {address} has another version of the program: {error}",
            where="EXPMAP_DASK",
            hint="install the same versions on all machines; see docs/cluster.md",
        ) from error
    _prepare(agreed, native_threads=min(native_threads, cores()))
    with at_work(**agreed.log.at_work):
        return function(value, item)


def _prepare(terms: Terms, *, native_threads: int) -> None:
    """Give this thread its native threads, and the process the storage that the work needs."""
    import faiss

    from webapp.files.object_storage.connect import connect

    with _LOCK:
        _once(terms.log.form, terms.settings.traces)
    # By default each worker takes all cores for each part. Its thread has a number of its own.
    faiss.omp_set_num_threads(native_threads)
    connect(terms.settings)


@cache
def _once(form: Form | None, traces: str | None) -> None:
    import cv2

    if form is not None:
        log_to_stderr(form)
    start_telemetry(traces)

    cv2.setNumThreads(1)
    keep_freed_memory()
