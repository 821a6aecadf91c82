"""Files that are sent to visitors of what is shared."""

from __future__ import annotations

import mimetypes
from pathlib import Path

from flask import Response, send_file

from webapp.tasks.satellite.display import Shown


def sent(path: Path, *, etag: str, kind: str | None = None) -> Response:
    """Send a file; browsers ask again each time: a share that was taken back shows nothing any more."""
    kind = kind or mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    response = send_file(path, mimetype=kind, etag=etag, conditional=True)
    response.headers["Cache-Control"] = "private, no-cache"
    return response


def shown(picture: Shown) -> Response:
    """Send what is shown of a map's image."""
    return sent(picture.path, etag=picture.key, kind=picture.mime)
