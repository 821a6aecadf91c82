"""The facts of photos in `map.json`, whose forms are also those of the database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime
from typing import Any

from webapp.core.boxes import MOST_BOXES, BlurBox
from webapp.core.geometry.tilt import Tilt
from webapp.core.mapmodel.facts import FixedForm, Form, NumberForm, TextForm
from webapp.core.mapmodel.model import FACTS, MapPhoto, PhotoSource
from webapp.core.mapmodel.panorama import Panorama
from webapp.files.json_fields import JsonField, finite

_TILTS = {"pitch_deg": 90.0, "roll_deg": 180.0}
"""Fields of a tilt, and how large they may be."""


def parse_facts(fields: Mapping[str, JsonField]) -> dict[str, Any]:
    """Read the facts of a photo strictly; unknown ones are left out."""
    return {
        name: _parsed(fields[name], fact.form) for name, fact in FACTS.items() if not fields[name].missing
    }


def fact_fields(photo: MapPhoto) -> dict[str, Any]:
    """Return the facts of a photo in the form of `map.json`; None where unknown."""
    return {name: to_json(fact.form, getattr(photo, name)) for name, fact in FACTS.items()}


def to_json(form: Form, value: Any) -> Any:
    """Return a fact in the form of `map.json`; None where unknown."""
    match form:
        case FixedForm.BOXES:
            return [box._asdict() for box in value] or None
        case FixedForm.SOURCE:
            return source_fields(value)
        case FixedForm.SPHERE:
            return panorama_fields(value)
        case _:
            return value


def from_json(form: Form, value: Any, *, where: str) -> Any:
    """Return a fact that was checked when it was stored; `where` names the photo in errors."""
    match form:
        case FixedForm.BOXES:
            return tuple(BlurBox(**box) for box in value or ())
        case FixedForm.SOURCE:
            return None if value is None else PhotoSource(**value)
        case FixedForm.SPHERE:
            return parse_panorama(value, where=where)
        case _:
            return value


def parse_text(field: JsonField, form: TextForm) -> str | None:
    """Read a text; None if it is missing, or empty although its form is limited."""
    if field.missing:
        return None
    text = field.text()
    problem = form.problem(text)
    if problem:
        raise field.error(problem)
    return text if form.most is None else text or None


def source_fields(source: PhotoSource | None) -> dict[str, str] | None:
    """Return the fields of a photo's source in `map.json`; None stays None."""
    return None if source is None else {name: text for name, text in asdict(source).items() if text}


def panorama_fields(panorama: Panorama | None) -> dict[str, Any] | None:
    """Return the data of a panorama in the form of `map.json`; None stays None."""
    if panorama is None:
        return None
    tilt = {} if panorama.tilt.is_level else asdict(panorama.tilt)
    return {"masked": [box._asdict() for box in panorama.masked], **tilt}


def parse_panorama(value: object, *, where: str = "panorama") -> Panorama | None:
    """Parse the data of a panorama in the form of `map.json`; None stays None."""
    return None if value is None else _panorama(JsonField(value, where, "$"))


def _parsed(field: JsonField, form: Form) -> Any:
    match form:
        case NumberForm():
            return field.number(form.valid_ones, valid=form.is_valid)
        case FixedForm.HEADING:
            return field.number("from 0 to 360", valid=lambda v: 0 <= v <= 360)
        case FixedForm.TIME:
            return _time(field)
        case TextForm():
            return parse_text(field, form)
        case FixedForm.BOXES:
            return _boxes(field)
        case FixedForm.SOURCE:
            return _source(field)
        case FixedForm.SPHERE:
            return _panorama(field)


def _time(field: JsonField) -> str:
    try:
        datetime.fromisoformat(field.text())
    except ValueError as error:
        raise field.error(
            "is not a time in ISO 8601", hint="write it like 2026-04-30T14:05:00+02:00"
        ) from error
    return field.text()


def _boxes(field: JsonField) -> tuple[BlurBox, ...]:
    boxes = tuple(_box(item) for item in field.items())
    if len(boxes) > MOST_BOXES:
        raise field.error(f"has {len(boxes)} boxes, more than {MOST_BOXES}", hint="draw larger boxes")
    return boxes


def _box(item: JsonField) -> BlurBox:
    """Read a box that lies inside the photo."""
    fields = item.record(required=BlurBox._fields)
    box = BlurBox(*(fields[side].number("a finite number", valid=finite) for side in BlurBox._fields))
    if not box.inside:
        raise item.error("is not a box inside the photo")
    return box


def _source(item: JsonField) -> PhotoSource:
    """Read the source of a photo; its URL must be http or https, because pages link to it."""
    fields = item.record(required=("service", "id", "licence"), optional=("author", "url"))
    known = {name: field.text() for name, field in fields.items() if not field.missing}
    if not known.get("url", "https://").startswith(("https://", "http://")):
        raise fields["url"].error("is not a web address", hint="it begins with https://")
    return PhotoSource(**known)


def _panorama(item: JsonField) -> Panorama:
    fields = item.record(required=(), optional=("masked", *_TILTS))
    tilt = Tilt(**{name: _angle(fields[name], most) for name, most in _TILTS.items()})
    return Panorama(tuple(_box(box) for box in fields["masked"].items()), tilt)


def _angle(field: JsonField, most: float) -> float:
    if field.missing:
        return 0.0
    return field.number(f"from -{most:g} to {most:g}", valid=lambda value: abs(value) <= most)
