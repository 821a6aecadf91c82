"""A scheduler and workers of Dask, as processes on this machine."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class DaskCluster:
    """Starts scheduler and workers, which can be killed separately."""

    def __init__(self, folder: Path, *, workers: int) -> None:
        self._folder = folder
        self.scheduler, self.address = self._start_scheduler()
        self.workers: list[subprocess.Popen[bytes]] = []
        for _ in range(workers):
            self.start_worker()

    def _start(self, *arguments: object, **environment: str) -> subprocess.Popen[bytes]:
        env = os.environ | {"PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "error"} | environment
        with (self._folder / "log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *map(str, arguments)],
                cwd=self._folder,
                env=env,
                stdout=log,
                stderr=log,
            )

    def _start_scheduler(self) -> tuple[subprocess.Popen[bytes], str]:
        facts = self._folder / "scheduler.json"
        process = self._start(
            *("scheduler", "--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", facts)
        )
        until = time.monotonic() + 30.0
        while True:
            try:
                return process, json.loads(facts.read_text())["address"]
            except (OSError, ValueError):
                assert process.poll() is None and time.monotonic() < until, self.log
                time.sleep(0.05)

    @property
    def log(self) -> str:
        return (self._folder / "log").read_text()

    def start_worker(self, **environment: str) -> subprocess.Popen[bytes]:
        process = self._start(
            *("worker", self.address, "--nthreads", 1, "--no-nanny", "--no-dashboard"),
            *("--local-directory", self._folder),
            **{"MALLOC_ARENA_MAX": "1", **environment},
        )
        self.workers.append(process)
        return process

    def wait(self, workers: int, seconds: float = 30.0) -> None:
        """Wait for a number of workers."""
        from distributed import Client

        until = time.monotonic() + seconds
        with Client(self.address, timeout=seconds, set_as_default=False) as client:
            while len(client.scheduler_info(n_workers=-1)["workers"]) != workers:
                assert time.monotonic() < until, self.log
                time.sleep(0.1)

    def stop(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
            process.wait()
