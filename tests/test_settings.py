"""What the environment sets, and what it cannot."""

from pathlib import Path

import pytest

from webapp.errors import UsageError
from webapp.settings import Settings, environment_for, from_environment


def test_nothing_is_set():
    assert from_environment({}) == Settings()
    assert (
        from_environment(dict.fromkeys(("EXPMAP_LIBRARY", "EXPMAP_MODELS", "EXPMAP_PROXIES"), ""))
        == Settings()
    )


def test_all_is_set():
    env = {"EXPMAP_LIBRARY": "/a", "EXPMAP_MODELS": "/b", "EXPMAP_TILES": "/c", "EXPMAP_PROXIES": "2"}
    found = from_environment(env)
    assert (found.library, found.models, found.tile_services) == (Path("/a"), Path("/b"), Path("/c"))
    assert found.web.proxies == 2


@pytest.mark.parametrize("text", ["yes", "-1", "1.5", "²"])
def test_a_number_of_proxies_that_is_none(text):
    with pytest.raises(UsageError, match="is no number"):
        from_environment({"EXPMAP_PROXIES": text})


def test_processes_of_the_server_have_few_threads_and_small_heaps(monkeypatch):
    for name in ("OMP_NUM_THREADS", "MALLOC_ARENA_MAX"):
        monkeypatch.delenv(name, raising=False)
    assert environment_for(3)["OMP_NUM_THREADS"] == "3"
    assert environment_for(3)["MALLOC_ARENA_MAX"] == "2"
    assert "OMP_NUM_THREADS" not in environment_for()
    monkeypatch.setenv("MALLOC_ARENA_MAX", "7")
    assert environment_for()["MALLOC_ARENA_MAX"] == "7"
