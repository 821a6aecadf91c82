"""Map services: layers of WMS and WMTS as images of maps, and below them."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.services.command:services", "List the layers of a WMS or WMTS, and offer one for maps."
)
