"""Sources of third-party photos in `map.json`."""

from __future__ import annotations

from dataclasses import asdict

from webapp.core.mapmodel.model import PhotoSource
from webapp.files.json_fields import JsonField


def parse_source(item: JsonField) -> PhotoSource:
    """Read the source of a photo; its URL must be http or https, because pages link to it.

    Raises
    ------
    MapJsonError
    """
    fields = item.record(required=("service", "id", "licence"), optional=("author", "url"))
    known = {name: field.text() for name, field in fields.items() if not field.missing}
    if not known.get("url", "https://").startswith(("https://", "http://")):
        raise fields["url"].error("is not a web address", hint="it begins with https://")
    return PhotoSource(**known)


def source_fields(source: PhotoSource | None) -> dict[str, str] | None:
    """Return the fields of a photo's source in `map.json`; None stays None."""
    return None if source is None else {name: text for name, text in asdict(source).items() if text}
