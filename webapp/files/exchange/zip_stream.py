"""Writes a zip as a stream, so that a map of any size can be sent without holding it in memory."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_CHUNK = 1 << 20
_TIME = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class ZipMember:
    name: str  # In the zip, with forward slashes
    # A path is read only when it is written; pieces are consumed one by one.
    content: bytes | Path | Iterable[bytes]
    # Whether the pieces may exceed 2 GB: that needs ZIP64, which old readers do not support.
    large: bool = False


def stream_zip(members: Iterable[ZipMember]) -> Iterator[bytes]:
    """Yield a zip of some files, piece by piece.

    Files given by path are stored, since photos are compressed already; bytes and pieces are deflated.
    """
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", allowZip64=True) as archive:
        for member in members:
            if isinstance(member.content, bytes):
                info = zipfile.ZipInfo(member.name, _TIME)
                info.external_attr = 0o644 << 16
                archive.writestr(info, member.content, zipfile.ZIP_DEFLATED)
            elif isinstance(member.content, Path):
                info = zipfile.ZipInfo.from_file(member.content, member.name, strict_timestamps=False)
                with member.content.open("rb") as source, archive.open(info, "w") as target:
                    while chunk := source.read(_CHUNK):
                        target.write(chunk)
                        yield sink.take()
            else:
                info = zipfile.ZipInfo(member.name, _TIME)
                info.compress_type = zipfile.ZIP_DEFLATED
                info.external_attr = 0o644 << 16
                with archive.open(info, "w", force_zip64=member.large) as target:
                    for piece in member.content:
                        target.write(piece)
                        yield sink.take()
            yield sink.take()
    yield sink.take()


class _Sink(io.RawIOBase):
    """Buffers written data until it is taken."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        part = bytes(data)
        self._parts.append(part)
        return len(part)

    def take(self) -> bytes:
        """Return the data written since the last call."""
        taken = b"".join(self._parts)
        self._parts.clear()
        return taken
