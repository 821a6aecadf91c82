"""Parts of a remote file, by HTTP range requests: bounded, cached on disk, and of one version of the file.

The file is read in blocks of equal size, which are kept. A server must say of each block that it belongs to
the same version (`ETag`, else `Last-Modified`): parts of two versions are never joined.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import requests

from webapp import __version__
from webapp.errors import InputError, StorageError
from webapp.net.bounded import answering, body
from webapp.net.public_hosts import public_session
from webapp.settings import RemoteSettings

BLOCK = 1 << 17
"""Bytes of a block, which is what one request asks for."""

_USER_AGENT = f"experience-map/{__version__} (parts of a file of map tiles)"
_CONTENT_RANGE = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})")
_MOST_REDIRECTS = 3
_REDIRECTS = (301, 302, 303, 307, 308)
_CHANGED = 412
_TRIM_EVERY = 64
"""Blocks that are written between two looks at the size of the cache."""


class RangeFile:
    """A remote file, of which parts are read; to be closed.

    Args:
        address: Its address.
        cache: Folder for the blocks of all files; created if missing.

    Raises:
        InputError: The server cannot be reached, does not send parts, or the file has changed meanwhile; also
            when it is read later.
        StorageError: The cache cannot be written.
    """

    def __init__(self, address: str, *, cache: Path, settings: RemoteSettings) -> None:
        self._address, self._settings = address, settings
        self._cache = cache
        self._folder = cache / hashlib.sha256(address.encode()).hexdigest()[:32]
        self._session = public_session(
            _USER_AGENT, allowed=settings.private_hosts, setting="remote.private_hosts"
        )
        self._asked = 0
        self._version, self.size = self._known() or self._first()

    def close(self) -> None:
        self._session.close()

    def __enter__(self) -> RangeFile:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def part(self, offset: int, length: int) -> bytes:
        """Return some bytes; fewer at the end of the file."""
        end = min(offset + length, self.size)
        if offset >= end:
            return b""
        if end - offset > self._settings.most_mb * 1e6:
            raise self._error(
                f"it asks for {end - offset} bytes at once", hint="write it anew, in smaller parts"
            )
        first, last = offset // BLOCK, (end - 1) // BLOCK
        whole = b"".join(self._block(number) for number in range(first, last + 1))
        return whole[offset - first * BLOCK : end - first * BLOCK]

    def _block(self, number: int) -> bytes:
        path = self._folder / self._version / f"{number}"
        length = min(BLOCK, self.size - number * BLOCK)
        try:
            data = path.read_bytes()
            if len(data) == length:
                return data
        except FileNotFoundError:
            pass
        except OSError as error:
            raise _unusable(error) from error
        self._asked += 1
        if self._asked * BLOCK > self._settings.most_mb * 1e6:
            raise self._error(
                f"one tile needs more than {self._settings.most_mb:g} MB of it",
                hint="the file is not made for this: write a cloud-optimised GeoTIFF, or PMTiles",
            )
        data, version, size = self._fetch(number)
        if (version, size) != (self._version, self.size):
            self._forget()
            raise self._error("the file has changed while it was read", hint="try again")
        self._keep(path, data)
        return data

    def _known(self) -> tuple[str, int] | None:
        """Return the version of the file, and its size, if they were looked up a short time ago."""
        path = self._folder / "version.json"
        try:
            if time.time() - path.stat().st_mtime > self._settings.check_s:
                return None
            found = json.loads(path.read_bytes())
            return str(found["version"]), int(found["size"])
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None
        except OSError as error:
            raise _unusable(error) from error

    def _first(self) -> tuple[str, int]:
        data, version, size = self._fetch(0)
        if not (self._folder / version).is_dir():
            self._forget()
        self._keep(self._folder / version / "0", data)
        self._keep(self._folder / "version.json", json.dumps({"version": version, "size": size}).encode())
        return version, size

    def _forget(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def _fetch(self, number: int) -> tuple[bytes, str, int]:
        """Request a block; return its bytes, the version of the file and its size."""
        begin = number * BLOCK
        headers = {"Range": f"bytes={begin}-{begin + BLOCK - 1}", "Accept-Encoding": "identity"}
        try:
            with self._answer(headers) as answer:
                return self._checked(answer, begin)
        except requests.RequestException as error:
            message = f"the server cannot be reached, or does not finish ({type(error).__name__})"
            raise self._error(message, hint="try again later") from error

    @contextmanager
    def _answer(self, headers: dict[str, str]) -> Iterator[requests.Response]:
        """Request a part, also where the server leads to; each host is checked before a connection to it."""
        address = self._address
        for _ in range(_MOST_REDIRECTS + 1):
            if urlsplit(address).scheme not in ("http", "https"):
                raise self._error(
                    "the server leads to an address that is not of the web", hint="use another one"
                )
            with ExitStack() as opened:
                try:
                    answer = opened.enter_context(
                        answering(
                            self._session,
                            address,
                            most_bytes=BLOCK,
                            timeout_s=self._settings.timeout_s,
                            headers=headers,
                        )
                    )
                except InputError as error:  # the host is not public
                    raise self._error(error.message, hint=error.hint or "") from error
                if answer.status_code not in _REDIRECTS or "Location" not in answer.headers:
                    yield answer
                    return
                address = urljoin(address, answer.headers["Location"])
        raise self._error("the server leads from address to address", hint="use the last of them")

    def _checked(self, answer: requests.Response, begin: int) -> tuple[bytes, str, int]:
        if answer.status_code == requests.codes.ok:
            raise self._error(
                "the server sends no parts of files", hint="put the file on one that answers range requests"
            )
        if answer.status_code == _CHANGED:
            self._forget()
            raise self._error("the file has changed while it was read", hint="try again")
        if answer.status_code != requests.codes.partial_content:
            raise self._error(f"the server answered {answer.status_code}", hint="check its address")
        found = _CONTENT_RANGE.fullmatch(answer.headers.get("Content-Range", ""))
        version = answer.headers.get("ETag") or answer.headers.get("Last-Modified") or ""
        if found is None or int(found[1]) != begin or not version:
            raise self._error(
                "the server does not say which part of which version it sends",
                hint="its answers need Content-Range, and ETag or Last-Modified",
            )
        size = int(found[3])
        data = body(answer, most_bytes=BLOCK)
        if data is None or len(data) != min(BLOCK, size - begin) or int(found[2]) != begin + len(data) - 1:
            raise self._error("the server sent a part of another length", hint="try again later")
        return data, hashlib.sha256(version.encode()).hexdigest()[:32], size

    def _keep(self, path: Path, data: bytes) -> None:
        part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(data)
            part.replace(path)
            if path.name.isdecimal() and int(path.name) % _TRIM_EVERY == 0:
                trim(self._cache, most_bytes=int(self._settings.cache_mb * 1e6))
        except FileNotFoundError:
            return  # another process has found a new version, and removed the folder
        except OSError as error:
            raise _unusable(error) from error

    def _error(self, message: str, *, hint: str) -> InputError:
        host = urlsplit(self._address).hostname  # an address may contain a key
        return InputError(message, where=f"remote file at {host}", hint=hint)


def trim(cache: Path, *, most_bytes: int) -> None:
    """Delete the oldest blocks until the rest has at most a number of bytes."""
    found = []
    for path in cache.glob("*/*/*"):
        try:
            about = path.stat()
        except FileNotFoundError:
            continue
        found.append((about.st_mtime, about.st_size, path))
    size = sum(length for _, length, _ in found)
    for _, length, path in sorted(found, key=lambda one: one[0]):
        if size <= most_bytes:
            return
        path.unlink(missing_ok=True)
        size -= length


def _unusable(error: OSError) -> StorageError:
    return StorageError(
        f"a part of a remote file cannot be kept: {error.strerror}",
        where="cache of remote files",
        hint="is the disk full?",
    )
