"""State and files of a shared map or answer, restricted to the contents of the share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flask import Response, url_for
from sqlalchemy.orm import Session

from webapp.core.mapmodel.model import FACTS
from webapp.errors import NotFound
from webapp.store import sharing
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of_files
from webapp.store.schema import MapRecord, Photo, QueryRecord
from webapp.store.sharing import OpenedShare, SharePermissions
from webapp.tasks.localize import show_query
from webapp.tasks.maps import pictures
from webapp.tasks.satellite.display import DisplayFile
from webapp.web.maps import state
from webapp.web.sending import send_revalidated
from webapp.web.state import library

_OF_EXIF = ("fov_deg", "fov_source")
"""Fields of an answer that come from EXIF."""

_OF_CAMERAS = ("name", "width", "height", "source", "preview")
"""Fields of a photo on the page with landmarks."""

_OF_THE_EARTH = ("metres_per_pixel", "latlon_grid")
"""Fields of a georeference that visitors get; its source is left out."""


def whole(session: Session, opened: OpenedShare, *, token: str) -> dict[str, Any]:
    """Return the whole state of a share.

    Returns:
        `name, revision, allows, satellite, georeference, notes, floors, photos, answer`: `photos` are the
            placed ones, `answer` is the shared answer or null.
    """
    present = [photo for photo in maps.photos(session, opened.map) if _is_on(photo)]
    return {**_about(session, opened, token), "photos": _photos(session, opened, present, token=token)}


def of_page(session: Session, opened: OpenedShare, *, token: str) -> dict[str, Any]:
    """Return the initial state for the page of a share: see `webapp.web.maps.state.of_page`."""
    # By id, as an order by time would show when the photos were taken.
    first = maps.photos_after(session, opened.map, -1, most=state.FIRST_PHOTOS, placed=True)
    shown = {photo.id for photo in first}
    others = (dot for dot in maps.dots(session, opened.map, placed=True) if dot.id not in shown)
    dots = state.columns(others)
    for name in FACTS.keys() & dots.keys():
        if not _allows(opened, name):
            dots[name] = [None] * len(dots["id"])
    return {
        **_about(session, opened, token),
        "token": token,
        "photos": _photos(session, opened, first, token=token),
        "dots": dots,
    }


def photos_after(
    session: Session, opened: OpenedShare, *, after: int, most: int, token: str
) -> dict[str, Any]:
    """Return the photos after an id: `photos`, and `next`, the id to continue after, or None at the end."""
    found = maps.photos_after(session, opened.map, after, most=most, placed=True)
    return {
        "photos": _photos(session, opened, found, token=token),
        "next": found[-1].id if len(found) == most else None,
    }


def _about(session: Session, opened: OpenedShare, token: str) -> dict[str, Any]:
    """Return the state of a share without its photos."""
    record, share = opened.map, opened.share
    found = state.image(record, base=_image_address(token))
    earth = found["georeference"]
    return {
        "name": record.name,
        "description": record.description,
        "revision": record.revision,
        "allows": {name: getattr(share, name) for name in SharePermissions.__slots__},
        "satellite": found["satellite"],
        "georeference": None if earth is None else {key: earth[key] for key in _OF_THE_EARTH},
        "notes": state.notes_json(record) if share.notes else [],
        "floors": state.floors_json(record, base=f"/api/v1/shared/{token}/floors"),
        "answer": None if opened.query is None else _answer(session, opened, opened.query, token=token),
    }


def photo(session: Session, opened: OpenedShare, *, id: int) -> tuple[MapRecord, Photo]:
    """Find a photo whose previews the share includes."""
    found = maps.photo(session, opened.map, id)
    if not _is_on(found) or not _shows(opened, id):
        raise NotFound(f"the map has no photo {id}", hint="reload the page")
    return opened.map, found


def query(opened: OpenedShare) -> QueryRecord:
    """Return the shared answer, if the share includes its photo. Raises NotFound."""
    if opened.query is None or not opened.share.photos:
        raise NotFound("photo not found")
    return opened.query


def open_landmarks(session: Session, token: str, *, originals: bool = False) -> OpenedShare:
    """Find a share that includes the landmarks. Raises NotFound.

    Args:
        originals: Whether it has to include original files, too.
    """
    opened = sharing.open_share(session, token)
    if not opened.share.landmarks:
        raise NotFound("this map is not shared in 3D", hint="ask the person who sent it for a new one")
    if originals and not opened.share.originals:
        raise files_not_shared()
    return opened


def files_not_shared() -> NotFound:
    """Make the error of a share that does not include original files."""
    return NotFound(pictures.NOT_SHARED)


def landmarks_page(opened: OpenedShare, *, token: str) -> dict[str, Any]:
    return {
        "name": opened.map.name,
        "token": token,
        "can_edit": False,
        "satellite": state.satellite_json(opened.map, base=_image_address(token)),
        "originals": opened.share.originals,
    }


def cameras(session: Session, opened: OpenedShare, *, token: str) -> dict[int, dict[str, Any]]:
    """Return the visible fields of the photos that can be cameras of landmarks, by id."""
    present = [photo for photo in maps.photos(session, opened.map) if _is_on(photo)]
    shown = _photos(session, opened, present, token=token)
    return {photo["id"]: {"placed": True, **{key: photo[key] for key in _OF_CAMERAS}} for photo in shown}


def answer_for_visitors(form: dict[str, Any], *, exif: bool) -> dict[str, Any]:
    """Return an answer in the form of `localize --json`; unless `exif`, without EXIF and file name."""
    return form if exif else {**form, "query": "", **dict.fromkeys(_OF_EXIF)}


def _is_on(photo: Photo) -> bool:
    return not photo.removed and photo.x_px is not None


def _shows(opened: OpenedShare, id: int) -> bool:
    """Return whether a share includes previews of a photo; a shared answer only those that it names."""
    if not opened.share.photos:
        return False
    return opened.query is None or id in _named(opened.query)


def _named(query: QueryRecord) -> set[int]:
    return {id for hypothesis in query.answer["hypotheses"] for id in hypothesis["experiences"]}


def _photos(
    session: Session, opened: OpenedShare, photos: Sequence[Photo], *, token: str
) -> list[dict[str, Any]]:
    blurred = boxes_of_files(session, (photo.sha256 for photo in photos)) if opened.share.originals else {}
    return [_photo(opened, photo, token, file=photo.sha256 not in blurred) for photo in photos]


def _allows(opened: OpenedShare, name: str) -> bool:
    """Return whether a share includes a fact of its photos."""
    visitors = FACTS[name].visitors
    return visitors == "always" or (visitors is not None and getattr(opened.share, visitors))


def _photo(opened: OpenedShare, photo: Photo, token: str, *, file: bool) -> dict[str, Any]:
    """Return a photo; `file`: whether its original file is for visitors."""
    shown = _shows(opened, photo.id)
    file = file and shown and opened.share.originals
    address = f"/api/v1/shared/{token}/photos/{photo.id}"
    return {
        "id": photo.id,
        "x_px": photo.x_px,
        "y_px": photo.y_px,
        "floor": photo.floor,
        "camera": photo.camera if opened.share.originals else None,
        "width": photo.width,
        "height": photo.height,
        **{
            name: value if _allows(opened, name) else None
            for name, value in state.facts_json(photo).items()
            if FACTS[name].visitors is not None
        },
        "thumb": f"{address}/thumb" if shown else None,
        "preview": f"{address}/preview" if shown else None,
        "original": f"{address}/original" if file else None,
    }


def _answer(session: Session, opened: OpenedShare, query: QueryRecord, *, token: str) -> dict[str, Any]:
    exif, shown = opened.share.originals, opened.share.photos
    file = shown and exif and show_query.looks(session, library(), rows=[query]) == [None]
    return {
        "name": query.name if exif else None,
        "at": query.at.isoformat(timespec="seconds"),
        "width": query.width,
        "height": query.height,
        **answer_for_visitors(query.answer, exif=exif),
        "thumb": url_for("api_shared.query_thumb", token=token) if shown else None,
        "preview": url_for("api_shared.query_preview", token=token) if shown else None,
        "original": url_for("api_shared.query_original", token=token) if file else None,
    }


def _image_address(token: str) -> str:
    return f"/api/v1/shared/{token}/satellite"


def send_display(picture: DisplayFile) -> Response:
    """Send a display file of a map's image."""
    return send_revalidated(picture.path, etag=picture.key, media_type=picture.mime)
