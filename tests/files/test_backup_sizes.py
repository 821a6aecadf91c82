"""A backup whose files are larger than its manifest says fills neither the disk nor the memory."""

import hashlib
import json
import zipfile

import pytest

from webapp.errors import InputError
from webapp.files.backup import FORMAT, MANIFEST, VERSION, read_manifest, unpack
from webapp.progress import Progress

HUGE = 100_000_000


def test_a_file_is_unpacked_no_further_than_the_manifest_says(tmp_path):
    archive, folder = tmp_path / "a.zip", tmp_path / "there"
    files = {"a": [10, hashlib.sha256(bytes(10)).hexdigest()]}
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        made.writestr("a", bytes(HUGE))
        made.writestr(MANIFEST, json.dumps({"format": FORMAT, "version": VERSION, "files": files}))
    with pytest.raises(InputError, match="damaged"):
        unpack(archive, folder, place=lambda name: folder / name, progress=Progress())
    assert (folder / "a").stat().st_size <= 2_000_000


def test_a_manifest_that_is_compressed_like_a_bomb_is_not_read(tmp_path):
    archive = tmp_path / "a.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        made.writestr(MANIFEST, b" " * HUGE)
    with pytest.raises(InputError, match="not a backup"):
        read_manifest(archive)
