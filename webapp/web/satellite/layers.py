"""What the page of a map may show below its image: tiles of a service, once somebody chooses it."""

from __future__ import annotations

from webapp.net.services import TileService, tile_services
from webapp.web.accounts.security import allow_images
from webapp.web.context import settings


def offered_layers() -> tuple[TileService, ...]:
    """Get the services for the page of this request, which may show their tiles from now on."""
    services = tile_services(settings().tile_services)
    allow_images(*sorted({service.origin for service in services}))
    return services
