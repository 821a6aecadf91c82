"""The web application as it is served: maps, missions and all their pages."""

from __future__ import annotations

from apiflask import APIFlask

from webapp.app.blueprints import BLUEPRINTS
from webapp.missions.store import shares as mission_shares
from webapp.missions.web.parameters import PATH_PARAMETERS
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.web import make_app
from webapp.web.state import Parts

PARTS = Parts(
    blueprints=BLUEPRINTS,
    public_lists={"missions": mission_shares.public},
    path_parameters=PATH_PARAMETERS,
)


def create_app(settings: Settings, *, library: Library | None = None) -> APIFlask:
    """Make the application.

    Parameters
    ----------
    library : Library, optional
        Opened already; else that of the settings is opened.

    Raises
    ------
    StorageError
        The library cannot be opened.
    """
    return make_app(settings, PARTS, library=library)
