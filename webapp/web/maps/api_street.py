"""API of street-level photos from services: a preview counts them, a job adds them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List, Nested, String
from apiflask.validators import OneOf

from webapp.progress import Progress
from webapp.settings import StreetSettings
from webapp.store.operate import jobs
from webapp.tasks.street.survey import (
    PANORAMA_WISHES,
    SOURCES,
    LibraryTarget,
    PixelBox,
    StreetRequest,
    check_request,
    services,
    survey_json,
    survey_street,
)
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import BoundedList
from webapp.web.maps.schemas import JobSchema
from webapp.web.operate.jobs import job_json

blueprint = APIBlueprint("api_street", __name__, url_prefix="/api/v1/maps/<slug>/street-photos", tag="Photos")

_limit = ConcurrencyLimit("street-level services", share=0.25)
blueprint.record(_limit.set_up)

_JOB = "street-photos"
_PATIENCE_S = 5.0
"""Timeout of a service, and longest pause that it may demand, within a request; jobs are more patient."""

_LIMIT_S = 20.0
"""Total time of querying a service within a request; the last query may take `_PATIENCE_S` more."""

_DIGITS = 2


class StreetServiceOut(Schema):
    """A configured service."""

    key = String(metadata={"enum": list(SOURCES)})
    name = String()


class StreetServicesOut(Schema):
    """The services that the settings configure, if any."""

    services = List(Nested(StreetServiceOut))


class StreetIn(Schema):
    """The requested photos."""

    source = String(required=True, validate=OneOf(SOURCES))
    area = BoundedList(
        Float(),
        load_default=None,
        allow_none=True,
        least=4,
        most=4,
        metadata={"description": "Left, top, right, bottom, map pixels; null for the whole image."},
    )
    panoramas = String(load_default="cut", validate=OneOf(PANORAMA_WISHES))


class StreetSurveyOut(Schema):
    """Summary of the service's photos of the area."""

    service = String()
    found = Integer()
    to_download = Integer(metadata={"description": "Photos that the map does not have."})
    panoramas = Integer(metadata={"description": "Number of panoramas to download."})
    size_mb = Float(metadata={"description": "Approximate size of the download, megabytes (10^6 bytes)."})
    licences = Dict(
        keys=String(), values=Integer(), metadata={"description": "Number of photos to download, by licence."}
    )
    authors = Integer()
    known = Integer(metadata={"description": "Photos that the map has already."})
    outside = Integer(metadata={"description": "Photos that are not on the image."})
    skipped = Integer(metadata={"description": "Panoramas that are not wanted."})
    unusable = Integer(metadata={"description": "Photos without a file, a position or a licence."})
    positions = List(List(Float()), metadata={"description": "x and y of those to download, map pixels."})


@blueprint.get("")
@blueprint.output(StreetServicesOut)
def list_services(slug: str) -> dict[str, Any]:
    """List the street-level services that this server is configured for."""
    open_map(slug)
    found = services(settings().street)
    return {"services": [{"key": key, "name": service.name} for key, service in found.items()]}


@blueprint.post("/preview")
@map_role("editor")
@blueprint.input(StreetIn, arg_name="data")
@blueprint.output(StreetSurveyOut)
def preview(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Query a service for its photos of an area; nothing is downloaded."""
    record = open_map(slug, "editor")
    target = LibraryTarget(library(), record.id, settings=settings())
    with _limit.slot():
        survey = survey_street(
            target, _request(data), settings=_settings_of_requests(), progress=Progress(), limit_s=_LIMIT_S
        )
    positions = [[round(side, _DIGITS) for side in one.pixel] for one in survey.wanted]
    return {**survey_json(survey), "positions": positions}


@blueprint.post("")
@map_role("editor")
@blueprint.input(StreetIn, arg_name="data")
@blueprint.output(JobSchema, status_code=202)
def add(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Queue a job that adds the photos of an area that the map does not have yet."""
    record, who = open_map(slug, "editor"), account()
    target = LibraryTarget(library(), record.id, settings=settings())
    check_request(target, _request(data), settings=settings().street)
    with library().database.write() as session:
        job = jobs.enqueue(
            session, _JOB, map_id=record.id, account_id=who.id, arguments=data, key=jobs.key_of(data)
        )
        session.flush()
        return job_json(session, job, account=who)


def _request(data: dict[str, Any]) -> StreetRequest:
    area = None if data["area"] is None else PixelBox(*data["area"])
    return StreetRequest(data["source"], area, data["panoramas"])


def _settings_of_requests() -> StreetSettings:
    chosen = settings().street
    return replace(
        chosen,
        timeout_s=min(chosen.timeout_s, _PATIENCE_S),
        patience_s=min(chosen.patience_s, _PATIENCE_S),
    )
