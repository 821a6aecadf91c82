"""Responses with files: their caching by browsers, and the names under which they are saved."""

from __future__ import annotations

import mimetypes
from pathlib import Path, PurePosixPath

from flask import Response, send_file

from webapp.tasks.exchange.export_source import Download

_MEDIA_TYPES = {".webp": "image/webp"}
"""Media types that Python before 3.13 does not know if the system has no list of them."""


def send_immutable(path: Path, *, etag: str) -> Response:
    """Send a file that never changes under its URL; browsers cache it."""
    return _send(path, etag=etag, caching="private, max-age=31536000, immutable")


def send_revalidated(path: Path, *, etag: str, media_type: str | None = None) -> Response:
    """Send a file that browsers have to revalidate each time, as access to it can be revoked."""
    return _send(path, etag=etag, caching="private, no-cache", media_type=media_type)


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


def send_pieces(download: Download) -> Response:
    """Stream a download as an attachment, under its own name."""
    response = Response(download.pieces, content_type=download.media_type)
    response.headers.set("Content-Disposition", "attachment", filename=download.name)
    response.headers["Cache-Control"] = "private, no-store"
    return response
