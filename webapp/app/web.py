"""The complete web application, with the blueprints of all subpackages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from apiflask import APIFlask
from flask import Blueprint

from webapp.app.registry import REGISTRY
from webapp.connect import connections
from webapp.importing import import_name
from webapp.missions.store import shares
from webapp.missions.web import (
    api_batches,
    api_drawings,
    api_events,
    api_exports,
    api_fixes,
    api_imports,
    api_missions,
    api_objects,
    api_phones,
    api_staged,
    api_tracks,
)
from webapp.missions.web import api_photos as mission_photos
from webapp.missions.web import api_shared as mission_shared
from webapp.missions.web import api_shares as mission_shares
from webapp.missions.web import pages as mission_pages
from webapp.missions.web.context import PATH_PARAMETERS
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.web import installable, make_app, manual
from webapp.web.accounts import api_accounts, codes
from webapp.web.accounts import pages as accounts_pages
from webapp.web.landmarks import api_cloud, api_pieces, api_place_rest, api_points
from webapp.web.landmarks import pages as landmarks_pages
from webapp.web.localize import api_localize, api_queries
from webapp.web.localize import pages as localize_pages
from webapp.web.maps import (
    api_blur,
    api_checks,
    api_exchange,
    api_floors,
    api_maps,
    api_notes,
    api_photos,
    api_placing,
    api_street,
    api_videos,
    view,
)
from webapp.web.maps import pages as maps_pages
from webapp.web.operate import doctor, jobs, metrics, models
from webapp.web.satellite import api_satellite
from webapp.web.satellite import pages as satellite_pages
from webapp.web.sharing import api_contributions, api_shared, api_shared_cloud, api_shares
from webapp.web.sharing import pages as sharing_pages
from webapp.web.state import Parts

BLUEPRINTS: tuple[Blueprint, ...] = (
    api_batches.blueprint,
    api_drawings.blueprint,
    api_events.blueprint,
    api_exports.blueprint,
    api_fixes.blueprint,
    api_imports.blueprint,
    api_missions.blueprint,
    api_objects.blueprint,
    api_batches.robots_api,
    api_staged.blueprint,
    mission_photos.blueprint,
    mission_shared.blueprint,
    mission_shares.blueprint,
    api_phones.phones_api,
    api_phones.positions_api,
    api_tracks.blueprint,
    mission_pages.mission_pages,
    mission_pages.public_pages,
    mission_pages.phone_pages,
    api_accounts.account_api,
    api_accounts.people_api,
    api_accounts.session_api,
    accounts_pages.account_pages,
    accounts_pages.people_pages,
    accounts_pages.sign_in_pages,
    codes.code_pages,
    api_exchange.blueprint,
    installable.blueprint,
    api_localize.find_api,
    api_localize.blueprint,
    api_queries.blueprint,
    localize_pages.blueprint,
    api_cloud.blueprint,
    api_points.blueprint,
    api_pieces.pieces_api,
    api_place_rest.landmarks_api,
    landmarks_pages.blueprint,
    api_blur.blur_api,
    api_checks.checks_api,
    api_checks.evaluation_api,
    api_maps.blueprint,
    api_photos.photos_api,
    api_photos.uploads_api,
    api_placing.placing_api,
    api_placing.placements_api,
    api_floors.blueprint,
    api_notes.blueprint,
    api_checks.plan_api,
    api_exchange.print_api,
    api_street.blueprint,
    api_videos.blueprint,
    manual.blueprint,
    maps_pages.blueprint,
    view.blueprint,
    jobs.health_pages,
    metrics.blueprint,
    jobs.jobs_api,
    jobs.jobs_pages,
    doctor.pages,
    models.pages,
    models.api,
    api_satellite.georeference_api,
    api_satellite.places_api,
    api_satellite.blueprint,
    satellite_pages.blueprint,
    api_shared.blueprint,
    api_shared_cloud.blueprint,
    api_shares.shares_api,
    api_contributions.visitors_api,
    api_contributions.waiting_api,
    api_shares.members_api,
    sharing_pages.blueprint,
    sharing_pages.members,
)

CONNECTED: tuple[Parts, ...] = tuple(
    import_name(found.web) for found in connections().values() if found.web is not None
)
"""The parts of the connections that are installed."""


def _joined(*tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    return {name: value for table in tables for name, value in table.items()}


WEB_PARTS = Parts(
    blueprints=(*BLUEPRINTS, *(blueprint for part in CONNECTED for blueprint in part.blueprints)),
    public_lists={"missions": shares.public},
    path_parameters=_joined(PATH_PARAMETERS, *(part.path_parameters for part in CONNECTED)),
    operations=_joined(
        api_staged.OPERATIONS,
        mission_shares.OPERATIONS,
        api_phones.OPERATIONS,
        models.OPERATIONS,
        *(part.operations for part in CONNECTED),
    ),
    short_jobs=REGISTRY.short(),
    exports={
        kind: tuple(link for part in CONNECTED for link in part.exports.get(kind, ()))
        for kind in ("map", "mission")
    },
    account_pages=tuple(page for part in CONNECTED for page in part.account_pages),
    sign_in_ways=tuple(way for part in CONNECTED for way in part.sign_in_ways),
)


def create_app(settings: Settings, *, library: Library | None = None) -> APIFlask:
    return make_app(settings, WEB_PARTS, library=library)
