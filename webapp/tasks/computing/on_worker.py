"""Runs a part on a Dask worker: checks the worker, then calls the function.

The scheduler imports this module, too; therefore it must not import large libraries at module level.
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
"""Distributions whose versions affect the results, or the compatibility between machines."""

_LOCK = threading.Lock()


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of the distributions in `_DECIDE`; an empty string if not installed."""
    found = {"experience-map": __version__, "Python": ".".join(platform.python_version_tuple()[:2])}
    for name in _DECIDE:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return MappingProxyType(found)


@dataclass(frozen=True, slots=True)
class WorkerRequirements:
    """Conditions under which a worker may run a part."""

    versions: Mapping[str, str]  # Versions of the submitting process
    marker: Path  # File in the folder that the parts need; it exists as long as the results are wanted
    settings: Settings
    log: Carried  # Log context of the submitting process

    def check(self, worker: str) -> None:
        """Refuse work if the versions differ here or the folder is not accessible. Raises UsageError."""
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
    """The shared value of all parts, in a worker's memory; it is unpickled there once."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._value: Any = None
        self._is_there = False
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the bytes, not the unpickled value."""
        return SharedValue, (self._data,)

    def value(self) -> Any:
        with self._lock:
            if not self._is_there:
                self._value, self._is_there = pickle.loads(self._data), True
            return self._value


def keep(data: bytes) -> SharedValue:
    """Wrap the shared value, which stays in the memory of a worker."""
    return SharedValue(data)


def do(part: bytes, shared: SharedValue, *, terms: bytes, native_threads: int) -> Any:
    """Run a part.

    Args:
        part: The function and the item, pickled, so that the scheduler need not unpickle them.
        shared: First argument of the function.
        terms: `WorkerRequirements`, pickled.
        native_threads: Number of threads for Faiss, limited to the cores of this machine.

    Raises:
        UsageError: This worker does not meet the terms.
    """
    with extra("cluster"):
        from distributed import get_worker

    address = get_worker().address
    try:
        agreed: WorkerRequirements = pickle.loads(terms)
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


def _prepare(terms: WorkerRequirements, *, native_threads: int) -> None:
    """Set the number of native threads of this thread, and open the object storage that the work needs."""
    import faiss

    from webapp.files.contents import connect

    with _LOCK:
        _once(terms.log.form, terms.settings.traces)
    # By default Faiss uses all cores for each part. OpenMP has this setting per thread.
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
