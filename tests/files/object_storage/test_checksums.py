"""Uploads carry their MD5, so that a server refuses damaged bytes."""

import base64
import hashlib
import os

import pytest


@pytest.fixture
def uploads(node, monkeypatch):
    """A storage, and the sent bytes and MD5 of each of its uploads."""
    one, sent = node(), []

    def look(request, **_):
        if request.method == "PUT":
            content = request.body.read()
            request.body.seek(0)
            sent.append((content, request.headers.get("Content-MD5")))

    one.bucket._client.meta.events.register("before-send.s3", look)
    return one, sent


@pytest.mark.parametrize(("size", "pieces"), [(0, 1), (3_000_000, 1), (20_000_000, 3)])
def test_a_file_and_each_of_its_pieces_is_sent_with_its_md5(uploads, tmp_path, size, pieces):
    one, sent = uploads
    path, content = tmp_path / "photo.jpg", os.urandom(size)
    path.write_bytes(content)
    one.bucket.put("ab/key", path)
    assert len(sent) == pieces and sum(len(piece) for piece, _ in sent) == size
    for piece, md5 in sent:
        assert md5 is not None
        assert base64.b64decode(md5) == hashlib.md5(piece, usedforsecurity=False).digest()
    one.bucket.get("ab/key", tmp_path / "back")
    assert (tmp_path / "back").read_bytes() == content
