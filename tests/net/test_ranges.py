"""Parts of remote files: of one version, bounded and kept; servers that cannot do it are named."""

import hashlib
import os

import pytest

from tests.net.range_server import serving
from webapp.errors import InputError
from webapp.net.ranges import BLOCK, RangeFile, trim
from webapp.settings import RemoteSettings

CONTENT = bytes(hashlib.sha256(b"x").digest()) * (BLOCK // 10)  # 3.2 blocks
LOCAL = RemoteSettings(enabled="yes", private_hosts="127.0.0.1")


@pytest.fixture
def server():
    with serving(CONTENT) as own:
        yield own


@pytest.fixture
def opened(server, tmp_path):
    def make(settings=LOCAL):
        return RangeFile(server.address, cache=tmp_path / "cache", settings=settings)

    return make


def test_a_file_is_read_in_parts_and_each_part_is_fetched_once(server, opened):
    with opened() as file:
        assert file.part(BLOCK - 3, 10) == CONTENT[BLOCK - 3 : BLOCK + 7]
        assert file.part(len(CONTENT) - 5, 99) == CONTENT[-5:]
        assert file.part(len(CONTENT) + 1, 5) == file.part(5, 0) == b""
    with opened() as file:
        assert file.part(0, file.size) == CONTENT
    wanted = [f"bytes={n * BLOCK}-{(n + 1) * BLOCK - 1}" for n in range(4)]
    assert sorted(server.asked) == wanted


def test_a_new_version_replaces_what_was_kept(server, opened, tmp_path):
    with opened() as file:
        assert file.part(0, file.size) == CONTENT
    server.content, server.tag = CONTENT[::-1], '"2"'
    with opened() as file:  # it is asked every hour
        assert file.part(0, 9) == CONTENT[:9]
    now = RemoteSettings(enabled="yes", private_hosts="127.0.0.1", check_s=0.0)
    with opened(now) as file:
        assert file.part(0, file.size) == CONTENT[::-1]
    assert len([*(tmp_path / "cache").glob("*/*/")]) == 1


def test_a_change_while_it_is_read_is_an_error_and_then_forgotten(server, opened):
    with opened() as file:
        server.tag = '"2"'
        with pytest.raises(InputError, match="changed while"):
            file.part(BLOCK, 5)
    with opened() as file:
        assert file.part(0, file.size) == CONTENT


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        ("whole", "sends no parts"),
        ("missing", "answered 404"),
        ("short", "another length"),
        ("cut", "cannot be reached, or does not finish"),
        ("elsewhere", "which part"),
        ("nameless", "which version"),
    ],
)
def test_servers_that_cannot_do_it_are_explained_without_the_address(server, opened, mode, message, tmp_path):
    server.mode = mode
    with pytest.raises(InputError, match=message) as caught:
        opened()
    assert caught.value.hint and "secret" not in f"{caught.value}{caught.value.where}{caught.value.hint}"
    assert [*(tmp_path / "cache").glob("*/*/0")] == []


def test_only_public_or_allowed_hosts_are_asked_also_after_redirects(server, opened, tmp_path):
    with pytest.raises(InputError, match="not a public address") as caught:
        opened(RemoteSettings(enabled="yes"))
    assert ("remote.private_hosts" in caught.value.hint, server.asked) == (True, [])
    for target, message in (
        ("http://127.0.0.2:9/a", "not a public address"),
        ("file:///etc/passwd", "not of the web"),
    ):
        server.mode, server.target = "redirect", target
        with pytest.raises(InputError, match=message):
            opened()
    server.mode, server.target = "redirect", "/b.pmtiles"
    with opened() as file:
        assert file.part(0, 5) == CONTENT[:5]


def test_a_server_that_leads_on_for_ever_is_left(server, opened, monkeypatch):
    server.target = server.address
    monkeypatch.setattr("webapp.net.ranges._MOST_REDIRECTS", -1)
    with pytest.raises(InputError, match="from address to address"):
        opened()


def test_what_is_fetched_and_kept_has_limits(server, opened, tmp_path):
    with opened(RemoteSettings(enabled="yes", private_hosts="127.0.0.1", most_mb=0.2)) as file:
        with pytest.raises(InputError, match="at once"):
            file.part(0, 300_000)
        file.part(BLOCK, 5)
        with pytest.raises(InputError, match=r"more than 0\.2 MB"):
            file.part(2 * BLOCK, 5)
    folder = tmp_path / "other" / "a" / "b"
    folder.mkdir(parents=True)
    for number in range(5):
        (folder / f"{number}").write_bytes(bytes(10))
        os.utime(folder / f"{number}", (number, number))
    trim(tmp_path / "other", most_bytes=25)
    assert sorted(path.name for path in folder.iterdir()) == ["3", "4"]
