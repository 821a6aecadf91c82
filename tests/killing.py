"""Kills a process at a step of its work, for tests of how the next start goes on."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any, NamedTuple

PRELOADED = ["pytest", "boto3", "webapp.cli.library", "webapp.jobs.map_jobs", "webapp.jobs.worker"]
_TIMEOUT_S = 300


class Step(NamedTuple):
    """A call at which a process is killed."""

    name: str  # "module:function" or "module:Class.method"
    calls: int = 0  # Number of calls that succeed first
    is_after: bool = False  # Killed when the call has returned, else instead of it


def run_until(step: Step, work: Callable[..., object], *args: Any) -> bool:
    """Run work in a new process that is killed at a step; return whether it got there.

    The process is forked from one that has loaded the program, but has no threads, which a fork would lose.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    process = context.Process(target=_run, args=(step, work, *args))
    process.start()
    process.join(_TIMEOUT_S)
    process.kill()  # only if it hangs
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL), f"{step}: exit code {process.exitcode}"
    return process.exitcode == -signal.SIGKILL


def die() -> None:
    """Kill this process."""
    os.kill(os.getpid(), signal.SIGKILL)


def _run(step: Step, work: Callable[..., object], *args: Any) -> None:
    module, _, path = step.name.partition(":")
    *owner, name = path.split(".")
    place = resolve_name(f"{module}:{'.'.join(owner)}")
    usual = getattr(place, name)
    done = []

    def call(*words: Any, **options: Any) -> Any:
        is_last = len(done) == step.calls
        done.append(name)
        if is_last and not step.is_after:
            die()
        result = usual(*words, **options)
        if is_last:
            die()
        return result

    setattr(place, name, call)
    work(*args)
