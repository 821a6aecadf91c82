"""Names of files in a zip, whose encoding the zip may not state.

Only a flag says that names are UTF-8. The Finder of macOS writes UTF-8 without it, Windows the code page of
the machine, and readers take all of these for CP437.
"""

from __future__ import annotations

import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

from webapp.files.listing import folded

_UTF8_FLAG = 0x800
_CODE_PAGES = ("cp437", "cp1252", "cp850", "cp1250", "cp852")
"""The first is that of the specification; the others are those of Windows in Western and Central Europe."""

_MOST_BYTES = 3_000_000
"""Of the `.cfg` files that are read for names: some 60 bytes for each file that a zip may have."""

_SLASH = ord("/")
_LONGEST_FOLDER = 4096
"""Bytes of a folder's name, as of a path on most systems."""

_UNREADABLE = (
    zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, OSError,
)  # fmt: skip
"""Exceptions of damaged and encrypted files, of which the import says more."""


def names_of(
    opened: zipfile.ZipFile, infos: Sequence[zipfile.ZipInfo], *, cfgs: Sequence[zipfile.ZipInfo]
) -> list[str]:
    """Return the names of files in a zip, in their order.

    A name whose encoding is not stated is UTF-8 if it is valid as such, or else in one code page for the
    whole zip: what the `.cfg` files in it name decides. A name in another Unicode form than there, such as
    the decomposed one of macOS, gets that of the `.cfg`.

    Args:
        cfgs: The `.cfg` files of the map, whose sizes were checked.
    """
    names = [info.filename for info in infos]
    if all(name.isascii() for name in names):
        return names
    unknown = {number: raw for number, info in enumerate(infos) if (raw := _raw(info)) is not None}
    named = _Named(opened, cfgs)
    pages = sorted(_CODE_PAGES, key=lambda page: -sum(named.has(raw, page) for raw in unknown.values()))
    for number, raw in unknown.items():
        pages_of_name = ["utf-8", pages[0]] if _decoded(raw, "utf-8") is not None else [pages[0]]
        page = next((page for page in pages_of_name if named.has(raw, page)), pages_of_name[0])
        names[number] = named.spelled(raw, page) or names[number]
    stated = {number: name for number, name in enumerate(names) if number not in unknown}
    for number, name in stated.items():
        names[number] = named.spelled(name.encode("utf-8", "surrogatepass"), "utf-8") or name
    return names


def _raw(info: zipfile.ZipInfo) -> bytes | None:
    """Return the bytes of a name whose encoding is not stated; None for others, and for ASCII."""
    name = info.orig_filename.partition("\0")[0]
    # `zipfile` replaces a name by the one in UTF-8 that Info-ZIP writes in an extra field
    if info.flag_bits & _UTF8_FLAG or name.isascii() or info.filename != name:
        return None
    return name.encode("cp437").replace(b"\\", b"/")


def _decoded(raw: bytes, encoding: str) -> str | None:
    try:
        return raw.decode(encoding)
    except UnicodeDecodeError:
        return None


class _Named:
    """What the `.cfg` files in a zip name, relative to their folders."""

    def __init__(self, opened: zipfile.ZipFile, cfgs: Sequence[zipfile.ZipInfo]) -> None:
        found: dict[bytes, dict[str, str]] = {}
        left = _MOST_BYTES
        for info in cfgs:
            if left <= 0:
                break
            raw = _raw(info)
            folder = (info.filename.encode() if raw is None else raw).rpartition(b"/")[0]
            data, most = b"", left
            left -= info.file_size  # also of a file that is damaged, which is only known when it is unpacked
            with suppress(*_UNREADABLE), opened.open(info) as file:
                data = file.read(most)
            found.setdefault(folder, {}).update((folded(name), name) for name in _names_in(data))
        self._names: Mapping[bytes, Mapping[str, str]] = found

    def has(self, raw: bytes, encoding: str) -> bool:
        """Return whether a `.cfg` names the file whose name is encoded like this."""
        return any(folded(inside) in names for inside, names in self._inside(raw, encoding))

    def spelled(self, raw: bytes, encoding: str) -> str | None:
        """Return a name in the Unicode form of the `.cfg` that names the file; None if it is not decoded."""
        name = _decoded(raw, encoding)
        for inside, names in self._inside(raw, encoding):
            other = names.get(folded(inside))
            if name is not None and other is not None and _composed(other) == _composed(inside):
                return name[: len(name) - len(inside)] + other
        return name

    def _inside(self, raw: bytes, encoding: str) -> Iterator[tuple[str, Mapping[str, str]]]:
        """Yield the name relative to each folder with a `.cfg` that it is in, and what this names."""
        ends = [at for at, byte in enumerate(raw[: _LONGEST_FOLDER + 1]) if byte == _SLASH]
        for end in (-1, *ends):
            names = self._names.get(raw[: max(end, 0)])
            inside = None if names is None else _decoded(raw[end + 1 :], encoding)
            if names is not None and inside is not None:
                yield inside, names


def _composed(name: str) -> str:
    return unicodedata.normalize("NFC", name)


def _names_in(data: bytes) -> Iterator[str]:
    for number, line in enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines()):
        cells = line.decode("utf-8", "ignore").split(";", 2)
        if number == 0 or len(cells) > 1:
            yield cells[min(number, 1)].strip()
