"""Limits of the size of requests, enforced while they are read; for `before_request` of blueprints."""

from __future__ import annotations

from flask import request

from webapp.web.state import settings

_OTHER_BYTES = 100_000
"""Allowance for the other fields of a form."""
_GEOREFERENCE_BYTES = 1_000_000
"""Allowance for the fields of a form other than an image: its georeference."""


def limit_photo(photos: int = 1) -> None:
    """Limit the request to a form with this many photos."""
    request.max_content_length = int(settings().photo.max_mb * 1e6 * photos) + _OTHER_BYTES


def limit_image() -> None:
    """Limit the request to a form with a satellite image or a plan."""
    if request.method in ("POST", "PUT"):
        request.max_content_length = int(settings().satellite.max_mb * 1e6) + _GEOREFERENCE_BYTES
