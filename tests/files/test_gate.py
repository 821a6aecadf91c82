"""The gate for files of strangers: a child process with limits, which ends with its caller."""

import logging
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from webapp.errors import Cancelled, TooSlow, TrackError, UsageError
from webapp.files import gate
from webapp.files.gate import Budget, budget_for
from webapp.progress import Progress
from webapp.settings import FileLimits

TARGETS = "tests.files.gate_targets"
USUAL = Budget(memory_mb=100, cpu_s=60, wait_s=60)


def run(name, *, budget=USUAL, progress=None, **arguments):
    return gate.run(f"{TARGETS}:{name}", arguments, budget=budget, progress=progress)


def is_alive(process):
    """Return whether a process exists and is no zombie."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][:1]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def ends(process, within_s=20.0):
    until = time.monotonic() + within_s
    while is_alive(process):
        if time.monotonic() > until:
            return False
        time.sleep(0.01)
    return True


def test_what_the_child_yields_arrives_in_order():
    assert list(run("count", n=1000)) == [str(number).encode() for number in range(1000)]


def test_the_child_is_forked_and_not_started_anew():
    list(run("count", n=1))
    began = time.perf_counter()
    for _ in range(20):
        list(run("count", n=1))
    assert (time.perf_counter() - began) / 20 < 0.5, "starting Python and importing NumPy takes longer"


def test_errors_of_the_reader_are_those_of_the_caller(caplog):
    with pytest.raises(TrackError) as caught:
        list(run("complain", kind="track"))
    assert (caught.value.message, caught.value.where, caught.value.hint) == (
        "it is damaged",
        "line 3",
        "mend it",
    )
    with pytest.raises(UsageError, match="no such option"):
        list(run("complain", kind="usage"))
    with caplog.at_level(logging.ERROR), pytest.raises(TrackError, match="cannot be read"):
        list(run("complain", kind="bug"))
    assert "KeyError: 'a bug'" in caplog.text, "the operator learns of the bug"


def test_memory_beyond_the_budget_is_one_clear_error():
    assert list(run("fill", size=50_000_000)) == [b"50000000"]
    with pytest.raises(TrackError, match="it needs more than 100 MB of memory to be read"):
        list(run("fill", size=200_000_000))


def test_time_beyond_the_budget_is_one_clear_error():
    with pytest.raises(TooSlow, match="it takes more than 1 s to be read"):
        list(run("loop", budget=Budget(100, cpu_s=1, wait_s=60)))
    with pytest.raises(TooSlow, match="more than"):
        list(run("wait", budget=Budget(100, cpu_s=60, wait_s=0.3)))


def test_a_child_that_crashes_is_an_error_of_the_file():
    with pytest.raises(TrackError, match="cannot be read"):
        list(run("crash"))


def test_a_message_without_end_is_refused():
    with pytest.raises(TrackError, match="too large"):
        list(run("huge"))


def test_the_child_writes_no_files(tmp_path):
    with pytest.raises(TrackError):
        list(run("write", path=str(tmp_path / "a")))
    assert not (tmp_path / "a").read_bytes()


@pytest.mark.parametrize("name", ["spin", "wait"])
def test_the_child_ends_when_nobody_reads_on(name):
    messages = run(name)
    process = int(next(messages))
    assert is_alive(process)
    messages.close()
    assert ends(process)


def test_the_child_ends_when_the_work_is_cancelled():
    class Stopped(Progress):
        stop = False

        def cancelled(self):
            return self.stop

    progress = Stopped()
    messages = run("spin", progress=progress)
    process = int(next(messages))
    progress.stop = True
    with pytest.raises(Cancelled):
        next(messages)
    assert ends(process)


def test_the_child_ends_when_its_caller_is_killed():
    command = [sys.executable, "-m", TARGETS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as caller:
        process = int(caller.stdout.readline())
        assert is_alive(process)
        caller.kill()
        caller.wait()
    assert ends(process)


def test_the_process_that_forks_may_be_killed_at_any_time():
    messages = run("wait")
    parent = int(Path(f"/proc/{next(messages).decode()}/stat").read_text().rpartition(") ")[2].split()[1])
    with suppress(ProcessLookupError):
        os.kill(parent, signal.SIGKILL)
    assert ends(parent)
    assert list(run("count", n=2)) == [b"0", b"1"]
    messages.close()


def test_a_budget_grows_with_the_file(tmp_path):
    (tmp_path / "a").write_bytes(bytes(2_000_000))
    (tmp_path / "b").write_bytes(bytes(1_000_000))
    limits = FileLimits(memory_mb=60, cpu_s=5, cpu_s_per_mb=2)
    assert budget_for(tmp_path / "a", limits) == Budget(60, 9, 90)
    assert budget_for(tmp_path, limits).cpu_s == 11
