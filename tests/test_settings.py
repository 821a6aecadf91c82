"""What the environment sets, and what it cannot."""

from pathlib import Path

import pytest

from webapp.errors import UsageError
from webapp.settings import Settings, from_environment


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
