"""API of the photo libraries of the caller's account, and of their albums on maps."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import OneOf, Range

from webapp.connect.libraries import asking, records
from webapp.connect.libraries.records import AlbumCounts
from webapp.store.photo_libraries import HERE, KEPT, TAKEN, LinkedAlbum, LinkedPhoto, PhotoLibrary
from webapp.store.schema import MapRecord
from webapp.web.context import account, authorized_by, library
from webapp.web.fields import LATER, Boolean
from webapp.web.maps.schemas import JobSchema
from webapp.web.operate.jobs import job_json

blueprint = APIBlueprint(
    "api_photo_libraries", __name__, url_prefix="/api/v1/account/libraries", tag="Photos"
)

_ID = "<id:id>"
_INTERVAL = [OneOf(records.INTERVALS_H), Range(min=0, max=max(records.INTERVALS_H))]
_EVERY = {"description": "Hours between two updates; 0: only on request."}
_WRITES_BACK = {
    "description": "Whether updates write positions that people set or accept here into the photo library."
}


class PhotoLibraryIn(Schema):
    """A photo library to connect; one that is connected gets the new key."""

    kind = String(required=True, validate=OneOf(list(records.KINDS)))
    address = String(required=True, validate=LATER)
    key = String(required=True, validate=LATER, metadata={"description": "Its API key; never in answers."})


class PhotoLibraryOut(Schema):
    """A connected photo library."""

    id = Integer()
    kind = String(validate=OneOf(list(records.KINDS)))
    address = String()
    created_at = String()


class PhotoAlbumOut(Schema):
    """An album in a photo library."""

    id = String()
    name = String()
    items = Integer(metadata={"description": "Photos and videos."})


class PhotoAlbums(Schema):
    """The albums that the API key gives access to."""

    albums = List(Nested(PhotoAlbumOut))


class AlbumLinkIn(Schema):
    """An album to put on a map."""

    album = String(required=True, validate=LATER, metadata={"description": "Its id in the photo library."})
    map = String(required=True, validate=LATER, metadata={"description": "A map that the caller may edit."})
    every_h = Integer(load_default=0, validate=_INTERVAL, metadata=_EVERY)
    writes_back = Boolean(load_default=False, metadata=_WRITES_BACK)


class AlbumLinkChange(Schema):
    """What is changed of a linked album."""

    every_h = Integer(validate=_INTERVAL, metadata=_EVERY)
    writes_back = Boolean(metadata=_WRITES_BACK)


class LinkedAlbumOut(Schema):
    """An album whose photos are on a map, and the state of its updates."""

    id = Integer()
    library = Integer(metadata={"description": "Id of the photo library."})
    map = String()
    album = String(metadata={"description": "Its id in the photo library."})
    name = String()
    every_h = Integer(metadata=_EVERY)
    writes_back = Boolean(metadata=_WRITES_BACK)
    photos = Integer(metadata={"description": "Photos of the album that are on the map."})
    kept = Integer(metadata={"description": "Photos of the map that are no longer in the album."})
    unusable = Integer()
    due_at = String(allow_none=True)
    updated_at = String(allow_none=True, metadata={"description": "End of the last complete update."})
    error = String(allow_none=True, metadata={"description": "Why the last update failed."})


class PhotoLibraries(Schema):
    """The photo libraries of the account and their albums on maps, the oldest first."""

    libraries = List(Nested(PhotoLibraryOut))
    linked = List(Nested(LinkedAlbumOut))


class LinkedPhotoOut(Schema):
    """A photo of a linked album."""

    asset = String(metadata={"description": "Its id in the photo library."})
    photo = Integer(allow_none=True, metadata={"description": "Its id on the map; null: it cannot be used."})
    state = String(
        validate=OneOf([HERE, KEPT, TAKEN]),
        metadata={"description": "No longer in the album: `kept` on the map, or `taken` from it, too."},
    )
    lat = Float(allow_none=True, metadata={"description": "Position in the photo library."})
    lon = Float(allow_none=True)
    written = Boolean(metadata={"description": "Whether that position was written from here."})
    problem = String(allow_none=True, metadata={"description": "Why its file cannot be used."})


class LinkedPhotos(Schema):
    """The photos of a linked album, by asset."""

    photos = List(Nested(LinkedPhotoOut))


def _check_library(id: int) -> None:
    with library().database.read() as session:
        records.find(session, account().id, id=id)


def _check_album(id: int) -> None:
    with library().database.read() as session:
        records.find_album(session, account().id, id=id)


_own_library = authorized_by(_check_library)
_own_album = authorized_by(_check_album)


@blueprint.get("")
@blueprint.output(PhotoLibraries)
def list_all() -> dict[str, Any]:
    """List the photo libraries of the caller, and the albums of them that are on maps."""
    with library().database.read() as session:
        linked = records.linked_albums(session, account().id)
        counts = records.counts(session, [album for album, _record in linked])
        return {
            "libraries": [_library(one) for one in records.list_libraries(session, account().id)],
            "linked": [_linked(album, record, counts[album.id]) for album, record in linked],
        }


@blueprint.post("")
@blueprint.input(PhotoLibraryIn, arg_name="data")
@blueprint.output(PhotoLibraryOut, status_code=201)
def connect(data: dict[str, str]) -> dict[str, Any]:
    """Connect a photo library, if it accepts the key."""
    added, _albums = asking.connect(data["kind"], data["address"], key=data["key"])
    return _library(added)


@blueprint.delete(f"/{_ID}")
@blueprint.output({}, status_code=204)
def remove(id: int) -> str:
    """Remove a photo library; its photos stay on the maps."""
    with library().database.write() as session:
        session.delete(records.find(session, account().id, id=id))
    return ""


@blueprint.get(f"/{_ID}/albums")
@blueprint.output(PhotoAlbums)
def list_albums(id: int) -> dict[str, Any]:
    """Ask a photo library for its albums."""
    return {"albums": [album._asdict() for album in asking.list_albums(id)]}


@blueprint.post(f"/{_ID}/albums")
@_own_library
@blueprint.input(AlbumLinkIn, arg_name="data")
@blueprint.output(LinkedAlbumOut, status_code=201)
def link(id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Put an album on a map that the caller may edit, and queue its first update."""
    options = {"every_h": data["every_h"], "writes_back": data["writes_back"]}
    return _linked_by(asking.link(id, data["album"], slug=data["map"], **options).id)


@blueprint.get(f"/albums/{_ID}")
@blueprint.output(LinkedAlbumOut)
def show_linked(id: int) -> dict[str, Any]:
    """Show the state of an album on a map."""
    return _linked_by(id)


@blueprint.patch(f"/albums/{_ID}")
@_own_album
@blueprint.input(AlbumLinkChange, arg_name="data")
@blueprint.output(LinkedAlbumOut)
def change_linked(id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Change when an album is updated, and whether positions are written back."""
    with library().database.write() as session:
        album = records.find_album(session, account().id, id=id)
        given = {"every_h": album.every_h, "writes_back": album.writes_back} | data
        records.change(session, album, **given)
    return _linked_by(id)


@blueprint.delete(f"/albums/{_ID}")
@blueprint.output({}, status_code=204)
def unlink(id: int) -> str:
    """Unlink an album; its photos stay on the map, and nothing changes in the photo library."""
    with library().database.write() as session:
        session.delete(records.find_album(session, account().id, id=id))
    return ""


@blueprint.post(f"/albums/{_ID}/update")
@blueprint.output(JobSchema, status_code=202)
def update(id: int) -> dict[str, Any]:
    """Queue an update: photos come in, changes are followed, positions go back if the album is so linked."""
    with library().database.write() as session:
        album = records.find_album(session, account().id, id=id)
        job = records.queue(session, album, account_id=account().id)
        session.flush()
        return job_json(session, job, account=account())


@blueprint.get(f"/albums/{_ID}/photos")
@blueprint.output(LinkedPhotos)
def list_photos(id: int) -> dict[str, Any]:
    """List the photos of an album on a map: which photo each is, and what of it was written back."""
    with library().database.read() as session:
        photos = records.linked_photos(session, records.find_album(session, account().id, id=id))
        return {"photos": [_photo(one) for one in photos]}


def _linked_by(id: int) -> dict[str, Any]:
    with library().database.read() as session:
        album = records.find_album(session, account().id, id=id)
        record = session.get_one(MapRecord, album.map_id)
        return _linked(album, record, records.counts(session, [album])[id])


def _library(one: PhotoLibrary) -> dict[str, Any]:
    return {"id": one.id, "kind": one.kind, "address": one.address, "created_at": _time(one.created_at)}


def _linked(album: LinkedAlbum, record: MapRecord, counts: AlbumCounts) -> dict[str, Any]:
    return {
        "id": album.id,
        "library": album.library_id,
        "map": record.slug,
        "album": album.album,
        "name": album.name,
        "every_h": album.every_h,
        "writes_back": album.writes_back,
        "photos": counts.here,
        "kept": counts.kept,
        "unusable": counts.unusable,
        "due_at": _time(album.due_at),
        "updated_at": _time(album.updated_at),
        "error": album.error,
    }


def _photo(one: LinkedPhoto) -> dict[str, Any]:
    names = ("asset", "state", "lat", "lon", "written", "problem")
    return {"photo": one.photo_id, **{name: getattr(one, name) for name in names}}


def _time(at: datetime | None) -> str | None:
    return None if at is None else at.isoformat(timespec="seconds")
