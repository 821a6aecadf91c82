"""Memory and threads of processes."""

import os
import platform
import subprocess
import sys

import pytest

from webapp.settings import environment_for, restrain_threads


def test_processes_of_the_server_have_few_threads_and_small_heaps(monkeypatch):
    for name in ("OMP_NUM_THREADS", "MALLOC_ARENA_MAX"):
        monkeypatch.delenv(name, raising=False)
    assert environment_for(3)["OMP_NUM_THREADS"] == "3"
    assert environment_for(3)["MALLOC_ARENA_MAX"] == "2"
    assert "OMP_NUM_THREADS" not in environment_for()
    monkeypatch.setenv("MALLOC_ARENA_MAX", "7")
    assert environment_for()["MALLOC_ARENA_MAX"] == "7"


def test_native_threads_are_restrained_unless_the_user_set_them(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_WAIT_POLICY", "active")
    restrain_threads()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert os.environ["OMP_WAIT_POLICY"] == "active"
    assert environment_for(3)["OPENBLAS_NUM_THREADS"] == "1"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's malloc only")
def test_memory_that_is_kept_is_not_asked_for_again():
    work = (
        "import resource, numpy as np\n"
        "from webapp.settings import keep_freed_memory\n"
        "keep_freed_memory()\n"
        "def use():\n"
        "    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "    for _ in range(20):\n"
        "        arrays = [np.ones(5 << 20, np.uint8) for _ in range(10)]\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before\n"
        "use()\n"
        "print(use())\n"
    )
    done = subprocess.run([sys.executable, "-c", work], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 100
