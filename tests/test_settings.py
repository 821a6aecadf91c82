"""What the environment sets, and what it cannot."""

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from webapp.errors import UsageError
from webapp.settings import Settings, environment_for, from_environment


def test_nothing_is_set():
    assert from_environment({}) == Settings()
    assert (
        from_environment(
            dict.fromkeys(("EXPMAP_LIBRARY", "EXPMAP_MODELS", "EXPMAP_PROXIES", "EXPMAP_MEMORY_MB"), "")
        )
        == Settings()
    )


def test_all_is_set():
    env = {"EXPMAP_LIBRARY": "/a", "EXPMAP_MODELS": "/b", "EXPMAP_TILES": "/c", "EXPMAP_PROXIES": "2"}
    found = from_environment(env | {"EXPMAP_MEMORY_MB": "64"})
    assert (found.library, found.models, found.tile_services) == (Path("/a"), Path("/b"), Path("/c"))
    assert found.web.proxies == 2
    assert found.retrieval.memory_mb == 64.0


@pytest.mark.parametrize("text", ["yes", "-1", "1.5", "²"])
def test_a_number_of_proxies_that_is_none(text):
    with pytest.raises(UsageError, match="is no number"):
        from_environment({"EXPMAP_PROXIES": text})


@pytest.mark.parametrize("text", ["much", "-1", "0.5", "1e3", "500 MB", "²"])
def test_megabytes_that_are_none(text):
    with pytest.raises(UsageError, match="is no number of megabytes") as refused:
        from_environment({"EXPMAP_MEMORY_MB": text})
    assert refused.value.where == "EXPMAP_MEMORY_MB"


def test_processes_of_the_server_have_few_threads_and_small_heaps(monkeypatch):
    for name in ("OMP_NUM_THREADS", "MALLOC_ARENA_MAX"):
        monkeypatch.delenv(name, raising=False)
    assert environment_for(3)["OMP_NUM_THREADS"] == "3"
    assert environment_for(3)["MALLOC_ARENA_MAX"] == "2"
    assert "OMP_NUM_THREADS" not in environment_for()
    monkeypatch.setenv("MALLOC_ARENA_MAX", "7")
    assert environment_for()["MALLOC_ARENA_MAX"] == "7"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told")
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
