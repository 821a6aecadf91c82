"""Background layers of pages: tiles of the services that the server offers."""

from __future__ import annotations

import logging

from webapp.errors import UsageError
from webapp.net.tiles import TileService, tile_services
from webapp.web.accounts.security import allow_images
from webapp.web.context import settings

_log = logging.getLogger(__name__)


def offered_layers(*, to_visitors: bool = False) -> tuple[TileService, ...]:
    """Return the services for the page of this request, and allow it to load their tiles.

    Empty, with a warning in the log, if the file of services cannot be used: pages work without them.

    Args:
        to_visitors: Whether to return only services whose URLs are public.
    """
    try:
        found = tile_services(settings().tile_services)
    except UsageError as error:
        _log.warning("no map tile services are offered: %s", error)
        return ()
    services = tuple(
        service
        for service in found
        if (service.public or not to_visitors)
        and (service.remote is None or settings().remote.enabled == "yes")
    )
    allow_images(*sorted({service.origin for service in services if not service.is_own}))
    return services


def configured_layers() -> tuple[TileService, ...]:
    """Return the services of the server's own file, if any; pages that use these contact them at once."""
    return () if settings().tile_services is None else offered_layers()
