"""Responses with files: their caching by browsers, and the names under which they are saved."""

from __future__ import annotations

import mimetypes
import time
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import cast

from flask import Response, send_file

from webapp.files.decode import IMAGE_FORMATS
from webapp.files.photos.photo import Kind
from webapp.tasks.exchange.export_source import Download
from webapp.tasks.maps import pictures
from webapp.tasks.maps.pictures import Audience, PhotoFile
from webapp.web.context import library, repeated_check, settings

CHECK_S = 1.0
"""Seconds between two checks of the right to get what is being sent; a check takes some milliseconds."""

_MEDIA_TYPES = {s: entry.media_types[0] for entry in IMAGE_FORMATS.values() for s in entry.suffixes}
"""By suffix: without a list of the system, Python does not know all of them."""


def send_immutable(path: Path, *, etag: str) -> Response:
    """Send a file that never changes under its URL; browsers cache it."""
    return _send(path, etag=etag, caching="private, max-age=31536000, immutable")


def send_revalidated(path: Path, *, etag: str, media_type: str | None = None) -> Response:
    """Send a file that browsers have to revalidate each time, as access to it can be revoked."""
    return _send(path, etag=etag, caching="private, no-cache", media_type=media_type)


def send_picture(photo: PhotoFile, *, kind: Kind, audience: Audience, changes_url: bool = False) -> Response:
    """Send a preview of a photo.

    Args:
        changes_url: Whether its URL contains a key of the blurred boxes, so that browsers can cache it.
    """
    shown = pictures.give_picture(library(), photo, kind=kind, audience=audience, settings=settings())
    return (send_immutable if changes_url else send_revalidated)(shown.path, etag=shown.etag)


def send_original(photo: PhotoFile, name: str, *, audience: Audience) -> Response:
    """Send the original file of a photo as an attachment, by default under its name on the server."""
    path = pictures.give_original(library(), photo, audience=audience)
    send = send_immutable if audience == "members" else send_revalidated
    return as_attachment(send(path, etag=photo.sha256), name, default=path.name)


def as_attachment(response: Response, name: str, *, default: str) -> Response:
    """Make a response an attachment, named by the last part of a client's file name, or by `default`."""
    last = PurePosixPath(name.replace("\\", "/")).name
    response.headers.set("Content-Disposition", "attachment", filename=last or default)
    return response


def _send(path: Path, *, etag: str, caching: str, media_type: str | None = None) -> Response:
    media_type = (
        media_type
        or _MEDIA_TYPES.get(path.suffix)
        or mimetypes.guess_type(path.name)[0]
        or "application/octet-stream"
    )
    response = send_file(path, mimetype=media_type, etag=etag, conditional=True)
    response.headers["Cache-Control"] = caching
    return response


class PiecesWhileAllowed(Iterator[bytes]):
    """Pieces of a response, of which none is sent once the caller's right has ended.

    That is checked before a piece is sent, at most once a second. The iteration raises the error of the
    check, which closes the connection: the client sees that the file is incomplete.
    """

    def __init__(self, pieces: Iterable[bytes]) -> None:
        self._source = pieces
        self._pieces = iter(pieces)
        self._check = repeated_check()
        self._check_at = time.monotonic() + CHECK_S

    def __next__(self) -> bytes:
        piece = next(self._pieces)
        if time.monotonic() >= self._check_at:
            self._check()
            self._check_at = time.monotonic() + CHECK_S
        return piece

    def close(self) -> None:
        close = getattr(self._source, "close", None)
        if close is not None:
            close()


def send_kept(path: Path, name: str) -> Response:
    """Send a large file as an attachment, as long as the caller may get it."""
    response = send_file(path, as_attachment=True, download_name=name)
    response.response = PiecesWhileAllowed(cast("Iterable[bytes]", response.response))
    return response


def send_pieces(download: Download) -> Response:
    """Stream a download as an attachment, under its own name, as long as the caller may get it.

    The view is marked by `authorized_by`, as for all that is sent while it is made.
    """
    response = Response(PiecesWhileAllowed(download.pieces), content_type=download.media_type)
    response.headers.set("Content-Disposition", "attachment", filename=download.name)
    response.headers["Cache-Control"] = "private, no-store"
    return response
