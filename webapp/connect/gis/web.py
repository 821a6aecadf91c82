"""What this connection adds to the web application."""

from __future__ import annotations

from webapp.connect.gis import downloads, ogc_api, stac
from webapp.web.state import Parts

PARTS = Parts(
    blueprints=(ogc_api.blueprint, stac.blueprint, downloads.blueprint),
    public_lists={},
    path_parameters=ogc_api.PATH_PARAMETERS,
    operations=ogc_api.OPERATIONS | stac.OPERATIONS | downloads.OPERATIONS,
    exports=downloads.MENU,
)
