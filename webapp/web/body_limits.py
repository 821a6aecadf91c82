"""How large a request may be, checked while it is read; for `before_request` of blueprints."""

from __future__ import annotations

from flask import request

from webapp.web.state import settings

_OTHER_BYTES = 100_000
"""Of a form, besides its files."""
_GEOREFERENCE_BYTES = 1_000_000
"""Of a form, besides an image: what lays it on the Earth."""


def limit_photo(photos: int = 1) -> None:
    """Allow a form with so many photos."""
    request.max_content_length = int(settings().photo.max_mb * 1e6 * photos) + _OTHER_BYTES


def limit_image() -> None:
    """Allow a form with a satellite image or a plan."""
    if request.method in ("POST", "PUT"):
        request.max_content_length = int(settings().satellite.max_mb * 1e6) + _GEOREFERENCE_BYTES
