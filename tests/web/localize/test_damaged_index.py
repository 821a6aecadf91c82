"""Derived files damaged while a map is served: an error in words, a repair by a job, never another place."""

import os
from dataclasses import replace

import pytest

from webapp.app.registry import REGISTRY
from webapp.jobs.worker import Worker
from webapp.settings import ExtractSettings
from webapp.tasks.maps import adopt_map

KINDS = ("manifest.json", "*.features", "*.ivf", "*.codebook", "calibration-*.json", "orientations-*.arrays")


def empty(_):
    return b""


def cut(data):
    return data[: len(data) // 2]


def garbage(data):
    return bytes(range(256)) * (len(data) // 256 + 1)


def flip(data):
    """Change one bit, of a digit or a keypoint."""
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


def foreign(_):
    return b"\x89PNG\r\n\x1a\n" + bytes(2000)


@pytest.fixture
def settings(settings):
    return replace(settings, extract=ExtractSettings(max_side_px=320, keypoints=120))


@pytest.fixture
def work(library, settings):
    def run():
        Worker(library, settings, registry=REGISTRY).run(once=True)

    return run


@pytest.fixture
def rows(library, owner, make_map, work):
    """Two maps of four photos each, ready to answer."""
    for slug in ("row", "other"):
        make_map(library.map_folder(slug), 4)
        adopt_map.adopt_map(library, slug, account_id=owner.id)
        work()


@pytest.fixture
def place(client, ask, library):
    """Localize the third photo; return the status, and the best place or the code of the error."""

    def run(slug):
        photo = library.map_folder(slug) / "photos" / "2.jpg"
        response = ask(client, photo, slug=slug, features="sift", method="verified")
        body = response.get_json()
        if response.status_code != 200:
            assert body["error"].keys() == {"code", "message", "where", "hint"}
            return response.status_code, body["error"]["code"]
        first = body["hypotheses"][0]
        return 200, (round(first["x_px"], 3), round(first["y_px"], 3))

    return run


def replace_file(path, data):
    """Write a file in another second than before, as a served map is opened again when its files change."""
    path.write_bytes(data)
    later = path.stat().st_mtime + 10
    os.utime(path, (later, later))


@pytest.mark.parametrize("damage", [empty, cut, garbage, flip, foreign])
def test_a_damaged_map_never_gives_another_place(library, rows, place, work, damage):
    expected = place("row")
    assert expected[0] == 200 and place("other")[0] == 200
    derived = library.map_folder("row") / "derived"
    whole = {}
    for kind in KINDS:
        whole |= {path: path.read_bytes() for path in derived.rglob(kind)}
        assert whole, kind
    for path, data in whole.items():
        replace_file(path, damage(data))
        assert place("row") in (expected, (409, "not_ready")), path.name
        replace_file(path, data)
    for path, data in whole.items():
        replace_file(path, damage(data))
    assert place("row") == (409, "not_ready")
    assert place("other")[0] == 200
    work()
    assert place("row") == expected
    for path, data in whole.items():
        if path.suffix in (".features", ".ivf", ".codebook"):
            assert path.read_bytes() == data, path.name
