"""KMZ: a zip with a KML in it, unpacked as a stream and only as far as limits allow."""

from __future__ import annotations

import io
import lzma
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO, cast

from webapp.errors import TrackError

MAX_BYTES = 200_000_000
MAX_RATIO = 200
_SMALL = 1_000_000
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError)
"""What `zipfile` raises for damaged, encrypted and unknown contents."""


@contextmanager
def opened_kml(path: Path) -> Iterator[BinaryIO]:
    """Open the KML of a KMZ: `doc.kml`, or else the first one.

    Raises
    ------
    TrackError
        It is no zip, has no KML, is encrypted or damaged, or claims to hold far more than a track; also
        while it is read.
    """
    try:
        archive = zipfile.ZipFile(path)
    except _BROKEN as error:
        raise TrackError(f"the zip is damaged: {str(error)[:200]}") from error
    with archive:
        info = _kml(archive)
        if info.file_size > MAX_BYTES or info.file_size > _SMALL + MAX_RATIO * info.compress_size:
            raise TrackError(
                f"the zip claims to hold {info.file_size / 1e6:.0f} MB in {info.compress_size} bytes",
                hint="export the track again",
            )
        try:
            packed = archive.open(info)
        except _BROKEN as error:
            raise TrackError(f"the zip is damaged or encrypted: {str(error)[:200]}") from error
        with packed:
            # zipfile gives no more bytes of an entry than it claims to have
            yield cast(BinaryIO, io.BufferedReader(_Told(packed)))


def _kml(archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    found = [info for info in archive.infolist() if info.filename.lower().endswith(".kml")]
    if not found:
        raise TrackError("the zip has no KML", hint="a KMZ has a doc.kml in it")
    return next((info for info in found if info.filename.lower() == "doc.kml"), found[0])


class _Told(io.RawIOBase):
    """The bytes of an entry; what is damaged in it is a `TrackError`."""

    def __init__(self, packed: IO[bytes]) -> None:
        self._packed = packed

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        try:
            data = self._packed.read(len(buffer))
        except _BROKEN as error:
            raise TrackError(f"the zip is damaged: {str(error)[:200]}") from error
        buffer[: len(data)] = data
        return len(data)
