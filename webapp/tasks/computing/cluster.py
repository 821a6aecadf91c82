"""Runs tasks on Dask workers, each of which checks itself before it calls a function.

The scheduler imports this module, too; therefore it must not import large libraries at module level.
"""

from __future__ import annotations

import logging
import math
import pickle
import platform
import secrets
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from typing import Any

from webapp import __version__
from webapp.errors import ClusterUnavailable, ProcessLost, StorageError, UsageError
from webapp.extras import extra
from webapp.logs import Carried, Form, at_work, carried, log_to_stderr
from webapp.progress import Progress
from webapp.settings import Settings, keep_freed_memory
from webapp.tasks.computing.local import LOOK_EVERY_S, Part
from webapp.telemetry import start as start_telemetry
from webapp.threads import cores

_CONNECT_S = 5.0
_WAIT_S = 10
_WAY_OUT = "start it, or unset EXPMAP_DASK to compute on this machine; what was finished is kept"
_EACH = 4
"""Submitted parts per worker thread, enough to keep it busy."""


class DaskPool:
    """Runs parts on the workers of a Dask scheduler. Raises ClusterUnavailable, UsageError, MissingPart."""

    def __init__(
        self, function: Part, shared: Any, *, settings: Settings, folder: Path, progress: Progress
    ) -> None:
        self._address = settings.dask or ""
        self._function = function
        self._progress = progress
        self._distributed = _distributed()
        self._counted, self._counted_at = 0, -math.inf
        self._marker = folder / f".computing-{secrets.token_hex(8)}"
        with ExitStack() as undone:
            self._client = self._connect()
            undone.callback(self._client.close)
            try:
                folder.mkdir(parents=True, exist_ok=True)
                self._marker.touch()
            except OSError as error:
                raise StorageError(
                    f"the folder cannot be written: {error.strerror}", where=str(folder)
                ) from error
            undone.callback(self._marker.unlink, missing_ok=True)
            terms = WorkerRequirements(dict(versions()), self._marker.absolute(), settings, carried())
            self._terms = pickle.dumps(terms)
            # A task, not scattered data, so that it is computed again if the workers that hold it are lost.
            self._shared = self._client.submit(keep_shared, pickle.dumps(shared), pure=False)
            undone.pop_all()

    def _connect(self) -> Any:
        try:
            return self._distributed.Client(
                self._address,
                timeout=_CONNECT_S,
                set_as_default=False,
                name="experience-map",
                loop=_loop_runner().loop,
            )
        except ValueError as error:
            raise UsageError(
                f"{self._address!r} is not the address of a Dask scheduler",
                where="EXPMAP_DASK",
                hint="write tcp://HOST:8786",
            ) from error
        except OSError as error:
            raise ClusterUnavailable(
                "the Dask scheduler cannot be reached", wait_s=_WAIT_S, where=self._address, hint=_WAY_OUT
            ) from error

    def _lost(self) -> ClusterUnavailable:
        return ClusterUnavailable(
            "the connection to the Dask scheduler is lost", wait_s=_WAIT_S, where=self._address, hint=_WAY_OUT
        )

    @property
    def at_once(self) -> int:
        """Maximum number of submitted parts; it follows the number of workers."""
        threads = self._threads()
        if not threads:
            self._progress.note("waiting for a worker of Dask")
        return _EACH * max(threads, 1)

    def _threads(self) -> int:
        """Count the threads of all workers; cached for half a second, as counting takes time."""
        if time.monotonic() > self._counted_at + LOOK_EVERY_S:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            self._counted = sum(worker["nthreads"] for worker in workers)
            self._counted_at = time.monotonic()
        return self._counted

    def submit(self, item: Any, *, of: int) -> Any:
        """Submit a part; with fewer parts than threads, each part may use more native threads."""
        return self._client.submit(
            do_part,
            pickle.dumps((self._function, item)),
            self._shared,
            terms=self._terms,
            native_threads=max(self._threads() // of, 1),
            pure=False,
        )

    def finished(self, waiting: Sequence[Any]) -> Iterator[Any]:
        """Yield the results of the first parts that are finished, in order.

        Raises ClusterUnavailable, ProcessLost, UsageError.
        """
        try:
            with self._client.as_current():
                self._distributed.wait([waiting[0]], timeout=LOOK_EVERY_S)
        except TimeoutError:
            pass
        except self._distributed.CancelledError as error:
            raise self._lost() from error
        if self._client.status != "running":
            raise self._lost()
        ready = list(takewhile(lambda future: future.status == "finished", waiting))
        if ready:
            yield from self._fetch(ready)
        elif waiting[0].status in ("error", "cancelled", "lost"):
            self._raise(waiting[0])

    def _fetch(self, ready: Sequence[Any]) -> list[Any]:
        """Fetch results in one batch; Dask recomputes those of a lost worker."""
        try:
            results: list[Any] = self._client.gather(ready)
        except (OSError, self._distributed.CancelledError) as error:
            raise self._lost() from error
        return results

    def _raise(self, future: Any) -> None:
        """Raise the error of a part, translated into an error of this program."""
        if future.status != "error":
            raise self._lost()
        error = future.exception()
        if isinstance(error, self._distributed.scheduler.KilledWorker):
            raise ProcessLost(
                "several workers of Dask were killed by the same part of the work",
                hint="too little memory? Give them more, or fewer threads",
            ) from error
        if isinstance(error, RuntimeError) and "deserialization" in str(error):
            raise UsageError(
                f"the Dask scheduler at {self._address} has another version of the program or of Dask",
                where="EXPMAP_DASK",
                hint="install the same versions on all machines; see docs/cluster.md",
            ) from error
        raise error

    def close(self, waiting: Sequence[Any]) -> None:
        """Cancel pending parts and disconnect from the scheduler."""
        try:
            self._marker.unlink(missing_ok=True)
        finally:
            if self._client.status == "running" and waiting:
                self._client.cancel(list(waiting), force=True)
            self._client.close(timeout=_CONNECT_S)


@cache
def _loop_runner() -> Any:
    """Start the event loop thread, once: starting one for each client failed occasionally."""
    runner = _distributed().utils.LoopRunner()
    runner.start()
    return runner


def _distributed() -> Any:
    with extra("cluster"):
        import distributed
    # Lost connections are reported as a single error instead of Dask's log output.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    return distributed


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


def keep_shared(data: bytes) -> SharedValue:
    """Wrap the shared value, which stays in the memory of a worker."""
    return SharedValue(data)


def do_part(part: bytes, shared: SharedValue, *, terms: bytes, native_threads: int) -> Any:
    """Run a part.

    Args:
        part: The function and the item, pickled, so that the scheduler need not unpickle them.
        shared: First argument of the function.
        terms: `WorkerRequirements`, pickled.
        native_threads: Number of threads for Faiss, limited to the cores of this machine.
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
