"""The web application as it is served: maps, missions and all their pages."""

from __future__ import annotations

from apiflask import APIFlask
from flask import Blueprint

from webapp.missions.store import shares as mission_shares
from webapp.missions.web.api_batches import blueprint as api_batches
from webapp.missions.web.api_events import blueprint as api_mission_events
from webapp.missions.web.api_exports import blueprint as api_mission_exports
from webapp.missions.web.api_fixes import blueprint as api_mission_fixes
from webapp.missions.web.api_imports import blueprint as api_mission_imports
from webapp.missions.web.api_missions import blueprint as api_missions
from webapp.missions.web.api_objects import blueprint as api_mission_objects
from webapp.missions.web.api_photos import blueprint as api_mission_photos
from webapp.missions.web.api_shared import blueprint as api_shared_missions
from webapp.missions.web.api_shares import blueprint as api_mission_shares
from webapp.missions.web.api_tracks import blueprint as api_tracks
from webapp.missions.web.context import PATH_PARAMETERS
from webapp.missions.web.pages import blueprint as mission_pages
from webapp.missions.web.pages import public_pages as public_mission_pages
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.web import make_app
from webapp.web.accounts.api_accounts import account_api as api_account
from webapp.web.accounts.api_accounts import people_api as api_people
from webapp.web.accounts.api_accounts import session_api as api_session
from webapp.web.accounts.pages import account_pages as account_page
from webapp.web.accounts.pages import people_pages as people_page
from webapp.web.accounts.pages import sign_in_pages as sign_in
from webapp.web.exchange.api_exchange import blueprint as api_exchange
from webapp.web.installable import blueprint as installable
from webapp.web.localize.api_localize import blueprint as api_localize
from webapp.web.localize.api_queries import blueprint as api_queries
from webapp.web.localize.pages import blueprint as localize_pages
from webapp.web.maps.api_checks import blueprint as api_checks
from webapp.web.maps.api_checks import evaluation_api as api_evaluation
from webapp.web.maps.api_maps import blueprint as api_maps
from webapp.web.maps.api_photos import blueprint as api_photos
from webapp.web.maps.api_photos import blur_api as api_blur
from webapp.web.maps.api_placing import blueprint as api_placing
from webapp.web.maps.api_placing import placements_api as api_placements
from webapp.web.maps.api_uploads import blueprint as api_uploads
from webapp.web.maps.pages import blueprint as map_pages
from webapp.web.operate.health import blueprint as health
from webapp.web.operate.jobs import blueprint as api_jobs
from webapp.web.operate.jobs import jobs_pages as jobs_page
from webapp.web.satellite.api_georeference import blueprint as api_georeference
from webapp.web.satellite.api_satellite import blueprint as api_satellite
from webapp.web.satellite.page import blueprint as satellite
from webapp.web.sharing.api_shared import blueprint as api_shared
from webapp.web.sharing.api_shares import blueprint as api_shares
from webapp.web.sharing.api_shares import members_api as api_members
from webapp.web.sharing.public_pages import blueprint as public_pages
from webapp.web.state import Parts

BLUEPRINTS: tuple[Blueprint, ...] = (
    account_page,
    api_account,
    api_batches,
    api_blur,
    api_checks,
    api_evaluation,
    api_exchange,
    api_georeference,
    api_jobs,
    api_localize,
    api_maps,
    api_members,
    api_mission_events,
    api_mission_exports,
    api_mission_imports,
    api_mission_fixes,
    api_mission_objects,
    api_mission_photos,
    api_mission_shares,
    api_missions,
    api_people,
    api_photos,
    api_placements,
    api_placing,
    api_queries,
    api_satellite,
    api_session,
    api_shared,
    api_shared_missions,
    api_shares,
    api_tracks,
    api_uploads,
    health,
    installable,
    jobs_page,
    map_pages,
    mission_pages,
    people_page,
    public_mission_pages,
    public_pages,
    localize_pages,
    satellite,
    sign_in,
)

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
