"""Ids of records in addresses: `<id:map_id>`."""

from __future__ import annotations

from apiflask import APIFlask
from werkzeug.routing import IntegerConverter, Map

from webapp.core.mapmodel.checks import MAX_NUMBER


class IdConverter(IntegerConverter):
    """A number that a database can have as an id; no address has a larger one."""

    def __init__(self, url_map: Map) -> None:
        super().__init__(url_map, max=MAX_NUMBER)


def init_app(app: APIFlask) -> None:
    """Let addresses use it; before the first that does."""
    app.url_map.converters["id"] = IdConverter
