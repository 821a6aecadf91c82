"""API of blurring parts of photos: manually, or as suggested by networks, in one photo or all."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, Integer, List, Nested, String
from apiflask.validators import OneOf, Range
from sqlalchemy import select
from sqlalchemy.orm import Session
from werkzeug.datastructures import FileStorage

from webapp.core.boxes import MOST_BOXES, BlurBox
from webapp.core.detections import Detection
from webapp.files.localize.models import NETWORKS, blur_networks, missing_networks
from webapp.files.part_file import discard, receive, show_file_as
from webapp.files.photos import panorama
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks.blur.find import DetectionCache, search_photo, suggestions
from webapp.tasks.maps import add_photo, pictures
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import Boolean, BoundedList
from webapp.web.maps import state
from webapp.web.maps.schemas import BoxOut, EditAnswer, PanoramaOut

blur_api = APIBlueprint("api_blur", __name__, url_prefix="/api/v1/maps/<slug>", tag="Photos")

_finding = ConcurrencyLimit("faces", share=0.25)
blur_api.record(_finding.set_up)

_JOB = "blur"


class BlurIn(Schema):
    """All parts to blur; an empty list for none."""

    boxes = BoundedList(Nested(BoxOut), required=True, most=MOST_BOXES)
    seen = BoundedList(
        Nested(BoxOut),
        most=MOST_BOXES,
        metadata={
            "description": "What was blurred when these were chosen; refused where other parts are now. "
            "Without it, whatever others have blurred meanwhile is replaced."
        },
    )


@blur_api.put("/photos/<id:id>/blur")
@map_role("editor")
@blur_api.input(BlurIn, arg_name="data")
@blur_api.output(EditAnswer)
def blur(slug: str, id: int, data: dict[str, list[dict[str, float]]]) -> dict[str, Any]:
    """Blur parts of a photo in all its previews; visitors never get the original file."""
    record = open_map(slug, "editor")
    given = {part: [BlurBox(**box) for box in boxes] for part, boxes in data.items()}
    wanted = pictures.NewBlur(**given)
    revision = pictures.blur_photo(library(), record.id, photo_id=id, wanted=wanted, settings=settings())
    return state.edited(record, revision)


class SuggestedBoxOut(BoxOut):
    """A face or a number plate, with a margin."""

    kind = String(validate=OneOf(["face", "plate"]))
    score = Float(metadata={"description": "How sure the network is, from 0 to 1; not calibrated."})


_LEFT = Integer(metadata={"description": "How many more were found than a photo may have boxes."})
_MISSING = List(
    String(validate=OneOf(["faces", "plates"])),
    metadata={
        "description": "Models that are not installed on the server: these things were not looked for."
    },
)


class BlurSuggestions(Schema):
    """Suggested parts that are not blurred yet, by falling score."""

    boxes = List(Nested(SuggestedBoxOut))
    left = _LEFT
    missing = _MISSING


@blur_api.get("/photos/<id:id>/blur/suggestions")
@blur_api.output(BlurSuggestions)
def suggest(slug: str, id: int) -> dict[str, Any]:
    """Find faces and number plates in a photo with the models `faces` and `plates`; nothing is changed."""
    record = open_map(slug, "editor")
    with library().database.read() as session:
        photo = maps.photo(session, record, id)
    networks = blur_networks(settings().models)
    source = pictures.original(library(), record.slug, photo=photo)
    kept = DetectionCache(library().map_folder(record.slug), networks.key)
    with _finding.slot(), show_file_as(photo.name, source):
        found = search_photo(source, networks=networks, kept=kept, limits=settings().photo)
    boxes, left = suggestions(found, blurred=boxes_of(photo))
    return {"boxes": _boxes_json(boxes), "left": left, "missing": networks.missing}


class PhotoSuggestions(Schema):
    """A photo with suggested parts."""

    id = Integer()
    name = String()
    boxes = List(Nested(SuggestedBoxOut), metadata={"description": "Not there with `boxes=0`."})
    left = _LEFT


class MapSuggestions(Schema):
    """Suggested parts in all photos of a map that have been searched."""

    photos = List(Nested(PhotoSuggestions))
    searched = Integer(metadata={"description": "Photos that have been searched."})
    total = Integer(metadata={"description": "Photos of the map."})
    missing = _MISSING
    job = Integer(
        allow_none=True, metadata={"description": "Id of the job that is searching or blurring them now."}
    )


class SearchIn(Schema):
    """Options of the search."""

    accept = Boolean(load_default=False, metadata={"description": "Blur all that is found."})
    least_score = Float(
        load_default=0.0,
        validate=Range(min=0, max=1),
        metadata={"description": "With `accept`: only detections with at least this score."},
    )


class FoundQuery(Schema):
    """Choice of the fields."""

    boxes = Boolean(
        load_default=True,
        metadata={"description": "`0` for the photos alone, without their boxes."},
    )


@blur_api.get("/blur/suggestions")
@blur_api.input(FoundQuery, location="query", arg_name="query")
@blur_api.output(MapSuggestions)
def list_suggestions(slug: str, query: dict[str, Any]) -> dict[str, Any]:
    """Get the detections in the photos of a map that are not blurred yet."""
    found = _of_map(open_map(slug, "editor"))
    if not query["boxes"]:
        for photo in found["photos"]:
            del photo["boxes"]
    return found


@blur_api.post("/blur/suggestions")
@map_role("editor")
@blur_api.input(SearchIn, arg_name="data")
@blur_api.output(MapSuggestions, status_code=202)
def search(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Queue a job that finds faces and number plates in all photos of a map, and optionally blurs them."""
    record, who = open_map(slug, "editor"), account()
    blur_networks(settings().models)  # fail early if no model is installed
    with library().database.write() as session:
        jobs.enqueue(
            session, _JOB, map_id=record.id, account_id=who.id, arguments=data, key=jobs.key_of(data)
        )
    return _of_map(record)


def _of_map(record: MapRecord) -> dict[str, Any]:
    missing = missing_networks(settings().models)
    found = {}
    if len(missing) < len(NETWORKS):
        networks = blur_networks(settings().models)
        found = DetectionCache(library().map_folder(record.slug), networks.key).read()
    with library().database.read() as session:
        photos = [photo for photo in maps.photos(session, record) if not photo.removed]
        job = _running(session, record)
    searched = [photo for photo in photos if photo.sha256 in found]
    boxes = [(p, *suggestions(found[p.sha256], blurred=boxes_of(p))) for p in searched]
    return {
        "photos": [
            {"id": p.id, "name": p.name, "boxes": _boxes_json(new), "left": left}
            for p, new, left in boxes
            if new or left
        ],
        "searched": len(searched),
        "total": len(photos),
        "missing": missing,
        "job": job,
    }


def _running(session: Session, record: MapRecord) -> int | None:
    running = select(Job.id).where(Job.map_id == record.id, Job.kind == _JOB, Job.state.not_in(ENDED))
    return session.scalars(running.limit(1)).first()


def _boxes_json(found: Iterable[Detection]) -> list[dict[str, Any]]:
    return [{**one.box._asdict(), "kind": one.kind, "score": round(one.score, 3)} for one in found]


class MaskIn(Schema):
    """A mask of panoramas."""

    file = File(  # type: ignore[no-untyped-call]
        required=True, metadata={"description": "an image twice as wide as high, black where it masks"}
    )


@blur_api.post("/photos/mask")
@map_role("editor")
@blur_api.input(MaskIn, location="files", arg_name="given")
@blur_api.output(PanoramaOut)
def read_mask(slug: str, given: dict[str, FileStorage]) -> dict[str, Any]:
    """Convert a mask image to boxes for the `panorama` of photos; nothing is changed."""
    open_map(slug, "editor")
    part = library().uploads / f"{secrets.token_hex(16)}.part"
    try:
        receive(part, given["file"].stream, max_bytes=int(settings().photo.max_mb * 1e6))
        with show_file_as(add_photo.tidy_name(given["file"].filename or ""), part):
            boxes = panorama.read_mask(part, limits=settings().photo)
    finally:
        discard(part)
    return {"masked": [box._asdict() for box in boxes]}
