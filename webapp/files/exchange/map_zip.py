"""Unpacks a zip with a map: only files that belong to the map, and never outside the folder.

Zips are untrusted: names, sizes and the number of files are checked before and while one is unpacked. A zip
may not state the encoding of its names: only a flag says that they are UTF-8. The Finder of macOS writes
UTF-8 without it, Windows the code page of the machine, and readers take all of these for CP437.
"""

from __future__ import annotations

import errno
import json
import lzma
import math
import os
import re
import stat
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from webapp.core.mapmodel.findings import quoted
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import InputError, MapError, PhotoError
from webapp.files.atomic import storage_error
from webapp.files.decode import IMAGE_FORMATS, image_size
from webapp.files.exchange.zip_directory import has_many_files
from webapp.files.listing import folded
from webapp.files.maps.map_json import parse_map_json
from webapp.files.part_file import check_space
from webapp.progress import Progress
from webapp.settings import ImportLimits

SUFFIX = ".zip"

_SMALL = 1_000_000
"""Bytes of a file up to which its compression ratio is not checked: text compresses well."""

_QUICK_FILES, _QUICK_BYTES, _QUICK_MEGAPIXELS = 300, 30_000_000, 40
"""Limits of an import within the request: files, their bytes unpacked, and the pixels of all images.

A megapixel takes 5 ms to decode, and up to 70 ms in an unusual file.
"""

_QUICK_CFG_BYTES, _QUICK_JSON_BYTES = 50_000, 300_000
"""Limits of text; a line of a `.cfg` has at least 8 bytes and takes 0.4 ms, a record of JSON 10 us."""

_HEADER_BYTES = 30
"""Minimum length of what precedes the data of a file."""

_CHUNK = 1 << 20
_TITLE = re.compile(
    r'\s*{\s*"format"\s*:\s*"[a-z-]+"\s*,\s*"version"\s*:\s*\d+\s*,\s*"title"\s*:\s*("(?:[^"\\]|\\.)*")'
)
_TITLE_BYTES = 5000
"""The beginning of a `map.json`, with its title, as `format_map_json` writes it."""

_MAX_NAME_BYTES = 200
_TEXT = frozenset({".cfg", ".json", ".xmp"})
_WANTED = _TEXT.union(*(entry.suffixes for entry in IMAGE_FORMATS.values()))
_IGNORED_FOLDERS = frozenset({"__MACOSX", "derived"})
_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError, ValueError)
"""Exceptions of `zipfile` for damaged, encrypted and unknown content."""

_OF_READERS = (None, errno.EINVAL)
"""`errno` of an OSError that means damage, not a failing disk: from bz2, and a seek before the start."""


@dataclass(frozen=True, slots=True)
class UnpackedMap:
    folder: Path
    cfgs: tuple[str, ...]  # The `.cfg` files, relative to the folder, sorted
    left_out: tuple[str, ...]  # Names in the zip of files that do not belong to a map


@dataclass(frozen=True, slots=True)
class _File:
    info: zipfile.ZipInfo
    name: str


def unpack(
    archive: Path,
    folder: Path,
    *,
    limits: ImportLimits,
    reserve_mb: float,
    progress: Progress,
    tables: frozenset[str] = frozenset(),
) -> UnpackedMap:
    """Unpack the photos, images, `.cfg` and `.json` files of a zip.

    Args:
        folder: New and empty.
        tables: Suffixes of further files to unpack.
        reserve_mb: Disk space to keep free, megabytes (10^6 bytes).

    Raises:
        InputError: The file is not a zip, is damaged or encrypted, has paths outside its folder or duplicate
            names, or exceeds the limits.
        StorageError: Writing failed, or the disk is too full (`DiskFull`).
    """
    _check_number(archive, limits)
    with _zip_errors(archive.name), zipfile.ZipFile(archive) as opened:
        files, left_out = _checked(opened, limits, _WANTED | tables)
        check_space(folder, sum(file.info.file_size for file in files), reserve_mb=reserve_mb)
        progress.size(len(files))
        for file in files:
            progress.check()
            _extract(opened, file, folder)
            progress.advance()
    cfgs = sorted(file.name for file in files if file.name.lower().endswith(".cfg"))
    return UnpackedMap(folder, tuple(cfgs), tuple(left_out))


def is_quick(archive: Path, *, limits: ImportLimits) -> bool:
    """Return whether a zip can be imported within seconds; True also if it is invalid."""
    if has_many_files(archive, limit=_QUICK_FILES):
        return False
    try:
        with zipfile.ZipFile(archive) as opened:
            if not _is_small(_stated(opened.infolist(), _WANTED)):  # before any file is unpacked
                return False
            files, _ = _checked(opened, limits, _WANTED)
            return _has_few_pixels(opened, files)
    except (*_BROKEN, InputError, OSError):
        return True  # the import refuses it at once


def _is_small(files: Sequence[_File]) -> bool:
    size = dict.fromkeys(_TEXT, 0)
    for file in files:
        suffix = PurePosixPath(file.name).suffix.lower()
        size[suffix] = size.get(suffix, 0) + file.info.file_size
    total = sum(size.values())
    is_short = size[".cfg"] <= _QUICK_CFG_BYTES and size[".json"] <= _QUICK_JSON_BYTES
    return len(files) <= _QUICK_FILES and is_short and total <= _QUICK_BYTES


def _has_few_pixels(opened: zipfile.ZipFile, files: Sequence[_File]) -> bool:
    """Add up the pixels that the headers declare; files that are no images are reported by the import."""
    left = _QUICK_MEGAPIXELS * 1e6
    for file in files:
        if PurePosixPath(file.name).suffix.lower() in _TEXT:
            continue
        with suppress(PhotoError):
            left -= math.prod(image_size(opened.read(file.info)))
        if left < 0:
            return False
    return True


def _check_number(archive: Path, limits: ImportLimits) -> None:
    """Refuse a zip with too many files by the size of its central directory, without reading that."""
    if has_many_files(archive, limit=limits.max_files):
        raise InputError(
            f"the zip has more files than the limit of {limits.max_files}",
            hint="leave out what is not part of the map",
        )


def read_title(archive: Path, *, most_files: int) -> str | None:
    """Read the title of the map in a zip, before it is unpacked.

    A large `map.json` is not parsed: its title is found where this program writes it.

    Returns:
        None if there is no title, or the map cannot be read: the import then reports why.
    """
    try:
        if has_many_files(archive, limit=most_files):
            return None
        with _zip_errors(archive.name), zipfile.ZipFile(archive) as opened:
            found = [info for info in opened.infolist() if PurePosixPath(info.filename).name == "map.json"]
            if len(found) != 1:
                return None
            with opened.open(found[0]) as file:
                if found[0].file_size <= _QUICK_JSON_BYTES:
                    return parse_map_json(file.read(_QUICK_JSON_BYTES)).title
                title = _TITLE.match(file.read(_TITLE_BYTES).decode("utf-8", "ignore"))
                return None if title is None else str(json.loads(title[1]))
    except (InputError, MapError, json.JSONDecodeError):
        return None


def _checked(
    opened: zipfile.ZipFile, limits: ImportLimits, suffixes: frozenset[str]
) -> tuple[list[_File], list[str]]:
    """Select the files to unpack; refuse the whole zip if any file is invalid."""
    infos = opened.infolist()
    if len(infos) > limits.max_files:
        raise InputError(
            f"the zip has {len(infos)} files, more than the limit of {limits.max_files}",
            hint="leave out what is not part of the map",
        )
    stated = _stated(infos, suffixes)
    for file in stated:
        _check_size(file.info, file.name, limits)
    _check_total(stated, limits)
    cfgs = [file.info for file in stated if file.name.lower().endswith(".cfg")]
    files, left_out, seen = [], [], dict[str, str]()
    for info, written in zip(infos, names_of(opened, infos, cfgs=cfgs), strict=True):
        name = _safe_name(info, written)
        if _is_folder(info):
            continue
        if not _wanted(name, suffixes):
            left_out.append(name)
            continue
        same = folded(name)
        if same in seen:
            raise InputError(
                f"the zip has {quoted(name)} and {quoted(seen[same])}, which are the same file on many "
                "file systems",
                hint="rename one of them",
            )
        seen[same] = name
        files.append(_File(info, name))
    for name in seen.values():
        above = (folded(str(p)) for p in PurePosixPath(name).parents)
        if any(parent in seen for parent in above):
            raise InputError(
                f"{quoted(name)} in the zip is inside a file instead of a folder",
                hint="zip the map's folder again",
            )
    return files, left_out


def _stated(infos: Sequence[zipfile.ZipInfo], suffixes: frozenset[str]) -> list[_File]:
    """Select the files to unpack by the names as they are stored, of which only the encoding is unknown."""
    names = [(info, info.filename.replace("\\", "/").removeprefix("./")) for info in infos]
    return [_File(info, name) for info, name in names if not _is_folder(info) and _wanted(name, suffixes)]


def _check_total(files: Sequence[_File], limits: ImportLimits) -> None:
    """Refuse files that share bytes of the zip, and too much data, absolutely and relative to the zip."""
    end = 0
    for info in sorted((file.info for file in files), key=lambda info: info.header_offset):
        if info.header_offset < end:
            raise InputError("files in the zip overlap", hint="zip the map's folder again")
        end = info.header_offset + _HEADER_BYTES + info.compress_size
    total, packed = (
        sum(file.info.file_size for file in files),
        sum(file.info.compress_size for file in files),
    )
    if total > limits.max_mb * 1e6:
        raise InputError(
            f"the zip has {total / 1e6:.0f} MB unpacked, more than the limit of {limits.max_mb:g}",
            hint="scale the photos down, or raise the limit",
        )
    if total > max(_SMALL, limits.max_ratio * packed):
        raise InputError(
            f"the zip would become {total / max(packed, 1):.0f} times as large when it is unpacked",
            hint="photos do not compress like this: check the files",
        )


def _is_folder(info: zipfile.ZipInfo) -> bool:
    return info.filename.endswith("/")  # `is_dir` fails for a file without a name


def _safe_name(info: zipfile.ZipInfo, name: str) -> str:
    name = name.removesuffix("/")
    name = name.replace("\\", "/").removeprefix("./")
    problem = None if _is_folder(info) and not name else name_problem(name)
    if problem:
        raise InputError(f"the zip has a file that a map cannot have: {problem.message}", hint="rename it")
    if stat.S_ISLNK(info.external_attr >> 16):
        raise InputError(f"{quoted(name)} in the zip is a link", hint="zip the files themselves")
    if info.flag_bits & 1:
        raise InputError(f"{quoted(name)} in the zip is encrypted", hint="zip the folder without a password")
    path = PurePosixPath(name)
    if any(len(part.encode()) > _MAX_NAME_BYTES for part in path.parts):
        raise InputError(
            "a name in the zip is too long for many file systems", where=quoted(name), hint="shorten it"
        )
    return path.as_posix()


def _wanted(name: str, suffixes: frozenset[str]) -> bool:
    path = PurePosixPath(name)
    hidden = any(part.startswith(".") or part in _IGNORED_FOLDERS for part in path.parts)
    return not hidden and path.suffix.lower() in suffixes


def _check_size(info: zipfile.ZipInfo, name: str, limits: ImportLimits) -> None:
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        # Python unpacks the others without a limit: a few kilobytes become gigabytes in memory
        raise InputError(
            f"{quoted(name)} in the zip is compressed by an unusual method",
            hint="make the zip again with the usual method, Deflate",
        )
    if info.file_size > _SMALL and info.file_size > limits.max_ratio * max(info.compress_size, 1):
        raise InputError(
            f"{quoted(name)} would become {info.file_size / max(info.compress_size, 1):.0f} times as large "
            "when it is unpacked",
            hint="photos do not compress like this: check the file",
        )


def _extract(opened: zipfile.ZipFile, file: _File, folder: Path) -> None:
    """Extract one file; its size must be the declared one."""
    target = folder / file.name
    target.parent.mkdir(parents=True, exist_ok=True)
    with opened.open(file.info) as source, target.open("xb") as sink:
        left = file.info.file_size
        while chunk := source.read(_CHUNK):
            left -= len(chunk)
            if left < 0:
                raise InputError(f"{quoted(file.name)} in the zip is larger than it claims")
            sink.write(chunk)
        sink.flush()
        os.fsync(sink.fileno())
    if left:
        raise InputError(f"{quoted(file.name)} in the zip is smaller than it claims", hint="zip it again")


@contextmanager
def _zip_errors(name: str) -> Iterator[None]:
    """Convert exceptions of `zipfile` to `InputError` or `StorageError`."""
    try:
        yield
    except _BROKEN as error:
        raise _damaged(error) from error
    except OSError as error:
        if error.errno in _OF_READERS:
            raise _damaged(error) from error
        raise storage_error(error, where=name) from error


def _damaged(reason: Exception) -> InputError:
    return InputError(f"this is not a zip, or it is damaged: {reason}", hint="zip the map's folder again")


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
