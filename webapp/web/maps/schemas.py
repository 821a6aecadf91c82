"""The schemas of maps, for the OpenAPI document and the API's responses."""

from __future__ import annotations

from typing import Any, ClassVar

from apiflask import Schema
from apiflask.fields import Boolean, Dict, Field, Float, Integer, List, Nested, String
from apiflask.validators import Length, Range

from webapp.core.mapmodel.facts import Edited, FixedForm, NumberForm, TextForm
from webapp.core.mapmodel.model import EDITED, FACTS, WRITTEN
from webapp.files.photos.panorama import MOST_MASKED
from webapp.web.fields import BoundedList, RecordNumber

_ROLES = ("owner", "editor", "viewer")
_MOST_TIME = 40
"""Characters of a time."""


class GpsOut(Schema):
    """GPS position of a photo."""

    lat = Float()
    lon = Float()
    accuracy_m = Float(allow_none=True)
    x_px = Float(allow_none=True, metadata={"description": "The same on the image; null without one."})
    y_px = Float(allow_none=True)
    radius_px = Float(allow_none=True, metadata={"description": "The accuracy, on the image."})


class BoxOut(Schema):
    """A part of a photo, in fractions of its width and height, from its top-left corner."""

    x = Float(required=True)
    y = Float(required=True)
    width = Float(required=True)
    height = Float(required=True)


class SourceOut(Schema):
    """Origin and licence of a photo from a street-level service."""

    service = String()
    id = String(metadata={"description": "Of the photo in the service."})
    licence = String()
    author = String()
    url = String(metadata={"description": "Page or record of the photo."})
    credit = String(metadata={"description": "The line that has to be shown with the photo."})


class PanoramaOut(Schema):
    """Properties of an equirectangular panorama of the whole sphere."""

    masked = BoundedList(
        Nested(BoxOut),
        load_default=list,
        most=MOST_MASKED,
        metadata={"description": "Parts in which nothing is recognised: the robot, the sky."},
    )
    pitch_deg = Float(
        validate=Range(-90.0, 90.0),
        metadata={"description": "Of its middle above the horizon; it is kept if left out."},
    )
    roll_deg = Float(
        validate=Range(-180.0, 180.0),
        metadata={"description": "Of the camera, clockwise; it is kept if left out."},
    )


def _fact_field(name: str, *, most: int | None = None, **metadata: str | None) -> Field[Any]:
    """Make the field of a fact of a photo; a text has at most so many characters."""
    about = {key: text for key, text in metadata.items() if text}
    match FACTS[name].form:
        case NumberForm() | FixedForm.HEADING:
            return Float(allow_none=True, metadata=about)
        case TextForm() | FixedForm.TIME:
            length = None if most is None else Length(max=most)
            return String(allow_none=name != "name", validate=length, metadata=about)
        case FixedForm.BOXES:
            return List(Nested(BoxOut), metadata=about)
        case FixedForm.SOURCE:
            return Nested(SourceOut, allow_none=True, metadata=about)
        case FixedForm.SPHERE:
            return Nested(PanoramaOut, allow_none=True, metadata=about)


def _new_value(name: str, edited: Edited) -> Field[Any]:
    """Make the field of a new value of a fact; null removes it."""
    most = WRITTEN[name].most if name in WRITTEN else _MOST_TIME
    return _fact_field(name, most=most, description=edited.description, example=edited.example)


class PhotoOut(Schema):
    """A photo of a map; a removed one has only `id`, `removed` and `revision`."""

    class Meta:
        """Adds the facts of a photo."""

        include: ClassVar = {
            name: _fact_field(name, description=fact.description)
            for name, fact in FACTS.items()
            if name != "gps_accuracy_m"  # it is in `gps`
        }

    id = Integer()
    x_px = Float(allow_none=True, metadata={"description": "null: in the tray, without a place."})
    y_px = Float(allow_none=True)
    radius_px = Float(
        allow_none=True,
        metadata={
            "description": "68 % radius of a position that was suggested and accepted; null: it is exact, or "
            "that of its GPS."
        },
    )
    floor = Integer(metadata={"description": "Id of its floor; 0 is that of the map's own image."})
    camera = String(
        allow_none=True,
        metadata={"description": "Maker and model by EXIF; null: not said, or added by an older version."},
    )
    width = Integer(metadata={"description": "Pixels of the upright photo."})
    height = Integer()
    gps = Nested(GpsOut, allow_none=True)
    gps_problem = String(
        allow_none=True, metadata={"description": "Why there is no GPS position, for people."}
    )
    file_notes = List(
        String(),
        metadata={
            "description": "Sentences about its file: where its position is from if not from EXIF, what was "
            "left out."
        },
    )
    revision = Integer(metadata={"description": "Of the map, when the photo last changed."})
    preview = String(metadata={"description": "Address of a picture of at most 1600 x 1600 pixels."})
    thumb = String(metadata={"description": "Address of a picture of at most 256 x 256 pixels."})
    removed = Boolean()


class PhotoChange(Schema):
    """New values for one photo; x and y are given together, null moves it to the tray."""

    class Meta:
        """Adds the facts that people edit."""

        include: ClassVar = {name: _new_value(name, edited) for name, edited in EDITED.items()}

    x_px = Float(allow_none=True)
    y_px = Float(allow_none=True)
    floor = RecordNumber(metadata={"description": "Id of the floor that it is on."})


class PageQuery(Schema):
    """The requested page of photos."""

    after = RecordNumber(least=-1, load_default=-1, metadata={"description": "An id."})
    limit = Integer(load_default=1000, validate=Range(1, 5000))


class PhotoPage(Schema):
    """Some photos of a map."""

    photos = List(Nested(PhotoOut))
    next = Integer(
        allow_none=True, metadata={"description": "Continue after this id; null: these were the last."}
    )


class PyramidOut(Schema):
    """Tiles of a large image."""

    url = String(metadata={"description": "With {z}, {x} and {y}."})
    max_zoom = Integer()


class SatelliteOut(Schema):
    """The image of a map."""

    url = String(metadata={"description": "Another content has another address."})
    width = Integer()
    height = Integer()
    tiles = Nested(PyramidOut, allow_none=True)
    attribution = String(allow_none=True, metadata={"description": "Attribution to show with the image."})


class PlacementOut(Schema):
    """Another set of positions for the photos of a map."""

    name = String()
    positions = Dict(
        keys=String(), values=List(Float()), metadata={"description": "x and y, pixels, by the photo's id."}
    )


class NoteOut(Schema):
    """A note on a spot of the map."""

    id = Integer()
    title = String()
    text = String()
    x_px = Float(allow_none=True, metadata={"description": "null: the present image does not show it."})
    y_px = Float(allow_none=True)
    photos = List(Integer(), metadata={"description": "Ids of the photos that it is about."})
    floor = Integer(metadata={"description": "Id of the floor that the spot is on."})


class FloorOut(Schema):
    """A floor of the map."""

    id = Integer(metadata={"description": "0 is the floor that the map's own image shows."})
    name = String()
    level = Float(metadata={"description": "Orders the floors; as OpenStreetMap's `level`."})
    height_m = Float(allow_none=True)
    url = String(
        allow_none=True,
        metadata={"description": "Of a picture that covers the map; null: the map's own image."},
    )
    attribution = String(allow_none=True)


class StepOut(Schema):
    """An edit that can be undone or redone."""

    kind = String()
    count = Integer(metadata={"description": "Photos it changed."})


class JobErrorOut(Schema):
    """Why a job failed."""

    message = String()
    where = String(allow_none=True)
    hint = String(allow_none=True)


class JobBehind(Schema):
    """The running job that a waiting one waits for."""

    kind = String()
    map_name = String(
        allow_none=True, metadata={"description": "null: it is of no map, or of one that you may not see."}
    )
    seconds_left = Float(allow_none=True)


class JobSchema(Schema):
    """A background job."""

    id = Integer()
    kind = String()
    state = String(metadata={"enum": ["queued", "running", "done", "failed", "cancelled"]})
    done = Integer()
    total = Integer(metadata={"description": "0 while it is not known."})
    note = String(metadata={"description": "What is being done now."})
    error = Nested(JobErrorOut, allow_none=True)
    result = Dict(allow_none=True, metadata={"description": "Depends on the kind."})
    seconds = Float(allow_none=True, metadata={"description": "So long it works, or worked; null: not yet."})
    seconds_left = Float(allow_none=True)
    next_try_s = Float(
        allow_none=True,
        metadata={"description": "Seconds until it is tried again because something was away; else null."},
    )
    behind = Nested(
        JobBehind, allow_none=True, metadata={"description": "What it waits for; null: it waits for nothing."}
    )
    created_at = String()
    mine = Boolean(metadata={"description": "Whether you have started it, and so may cancel it."})
    map = String(allow_none=True, metadata={"description": "Its slug."})


class _Changed(Schema):
    satellite = Nested(SatelliteOut, allow_none=True)
    georeference = Dict(
        allow_none=True,
        metadata={"description": "As in `map.json`, with `metres_per_pixel` and a `latlon_grid` for pages."},
    )
    photos = List(Nested(PhotoOut))
    placements = List(Nested(PlacementOut))
    notes = List(Nested(NoteOut))
    floors = List(
        Nested(FloorOut), metadata={"description": "The lowest first; none: the map has one image alone."}
    )
    undo = Nested(StepOut, allow_none=True, metadata={"description": "Your last edit."})
    redo = Nested(StepOut, allow_none=True, metadata={"description": "Your last undone edit."})


class MapState(_Changed):
    """The whole state of a map."""

    slug = String()
    name = String()
    description = String(allow_none=True, metadata={"description": "What the map is, for visitors."})
    role = String(metadata={"enum": list(_ROLES), "description": "Of the caller."})
    can_edit = Boolean()
    binned = Boolean()
    revision = Integer()


class MapChanges(_Changed):
    """Changes since a revision; `satellite`, `georeference` and `placements` only if they changed."""

    revision = Integer()
    jobs = List(Nested(JobSchema), metadata={"description": "Waiting, at work, or just ended."})


class EditAnswer(_Changed):
    """Changes made by an edit; `satellite` and `georeference` only if it changed the image."""

    revision = Integer(allow_none=True, metadata={"description": "Of this edit; null if nothing changed."})
