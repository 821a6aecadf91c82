"""Memory-mapped copies count as in use, however long ago they were requested."""

import os
import sys
import time

import numpy as np
import pytest

from tests.s3_server import using
from webapp.files import contents
from webapp.files.object_storage import cache


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
def test_a_file_that_stays_mapped_is_not_evicted(node, tmp_path):
    paths = [tmp_path / f"{name}.jpg" for name in ("the index", "old", "new")]
    for path in paths:
        path.write_bytes(os.urandom(1000))
    with using(node()):
        for path in paths:
            contents.publish(path)
    with using(node("small", limit=2500, stays_s=0.0)):
        places, open_map = [], None
        for path in paths:
            places.append(contents.local(path))
            open_map = np.memmap(places[0], np.uint8, "r") if open_map is None else open_map
            time.sleep(0.01)
        assert [place.exists() for place in places] == [True, False, True]
        del open_map
        assert cache.mapped_names(places[0].parent) == set()


def test_a_system_without_proc_shows_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "_PROCESSES", tmp_path / "none")
    assert cache.mapped_names(tmp_path) == set()
