"""A lock ends with its process."""

import subprocess
import sys

from webapp.jobs.health import ProcessLock

HOLD = """
import sys, time
from pathlib import Path
from webapp.jobs.health import ProcessLock
sign = ProcessLock(Path(sys.argv[1]))
print(sign.name, flush=True)
time.sleep(600)
"""


def test_a_killed_process_is_gone_and_a_living_one_is_not(tmp_path):
    own = ProcessLock(tmp_path)
    with subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE, text=True) as other:
        name = other.stdout.readline().strip()
        assert not own.is_gone(name)
        assert len(list(tmp_path.iterdir())) == 2
        other.kill()
    assert own.is_gone(name)
    assert own.is_gone(name)
    assert len(list(tmp_path.iterdir())) == 1
    assert not own.is_gone(own.name)


def test_of_other_machines_nothing_is_known(tmp_path):
    assert not ProcessLock(tmp_path).is_gone("elsewhere:77:abc")


def test_it_is_taken_away_in_the_end(tmp_path):
    first, second = ProcessLock(tmp_path), ProcessLock(tmp_path)
    assert first.name != second.name
    first.release()
    assert second.is_gone(first.name)
