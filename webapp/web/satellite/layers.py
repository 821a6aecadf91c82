"""What a page may show below an image: tiles of the services that the server offers."""

from __future__ import annotations

import logging

from webapp.errors import UsageError
from webapp.net.services import TileService, tile_services
from webapp.web.accounts.security import allow_images
from webapp.web.context import settings

_log = logging.getLogger(__name__)


def offered_layers(*, to_visitors: bool = False) -> tuple[TileService, ...]:
    """Get the services for the page of this request, which may show their tiles from now on.

    None where their file cannot be used, which the log then says: pages do without them.

    Parameters
    ----------
    to_visitors : bool
        Only those whose addresses everybody may see.
    """
    try:
        found = tile_services(settings().tile_services)
    except UsageError as error:
        _log.warning("no map tile services are offered: %s", error)
        return ()
    services = tuple(service for service in found if service.public or not to_visitors)
    allow_images(*sorted({service.origin for service in services}))
    return services


def configured_layers() -> tuple[TileService, ...]:
    """Get those that the server's own file names: other hosts are asked at once for what these show."""
    return () if settings().tile_services is None else offered_layers()
