"""The fields of a robot's records and their limits, defined once.

The client validates records with this table before it stores them, the server when it receives them, and the
API's schema is derived from it. This is the only module of `webapp.robot` that the server may import; it
needs the standard library only.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

Source = Literal["gps", "odometry", "visual", "fused", "manual"]
"""Origin of poses: a GPS receiver, dead reckoning, photos localized on the map, fusion, or a person."""

SOURCES: tuple[Source, ...] = get_args(Source)

FAR = 1e12
"""Upper bound of times in seconds, and of distances and heights in metres."""

_SHA256 = "[0-9a-f]{64}"


class FieldError(ValueError):
    """A record is invalid.

    Args:
        name: The invalid field; empty if the error concerns the whole record.
    """

    def __init__(self, message: str, name: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.name = name


@dataclass(frozen=True, slots=True)
class Field(ABC):
    """Type and limits of a field; in an optional field, null counts as missing."""

    description: str
    required: bool = field(default=False, kw_only=True)

    @abstractmethod
    def check(self, name: str, value: object) -> Any:
        """Return the value, or raise FieldError."""

    @abstractmethod
    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema."""


@dataclass(frozen=True, slots=True)
class Number(Field):
    """A finite number; true and false are not numbers."""

    least: float = -FAR
    most: float = FAR
    whole: bool = False

    def check(self, name: str, value: object) -> float:
        """Return the value as a float, or as an int if `whole`."""
        if type(value) is not int and (self.whole or type(value) is not float):
            raise FieldError(f"it must be {'a whole number' if self.whole else 'a number'}", name)
        if not self.least <= value <= self.most:
            raise FieldError(f"it must be a number from {self.least:g} to {self.most:g}", name)
        return value if self.whole else float(value)

    def schema(self) -> dict[str, Any]:
        """Return its JSON Schema."""
        kind = "integer" if self.whole else "number"
        return {"type": kind, "minimum": self.least, "maximum": self.most, "description": self.description}


@dataclass(frozen=True, slots=True)
class Text(Field):
    """Printable characters."""

    least: int = 1
    most: int = 200
    pattern: str | None = None

    def check(self, name: str, value: object) -> str:
        if not isinstance(value, str) or not self.least <= len(value) <= self.most or not value.isprintable():
            raise FieldError(f"it must be text of {self.least} to {self.most} printable characters", name)
        if self.pattern is not None and not re.fullmatch(self.pattern, value):
            raise FieldError(f"it must match {self.pattern}", name)
        return value

    def schema(self) -> dict[str, Any]:
        """Return its JSON Schema."""
        found = {
            "type": "string",
            "minLength": self.least,
            "maxLength": self.most,
            "description": self.description,
        }
        return found if self.pattern is None else found | {"pattern": f"^{self.pattern}$"}


@dataclass(frozen=True, slots=True)
class Choice(Field):
    """One of several strings."""

    choices: tuple[str, ...]
    default: str

    def check(self, name: str, value: object) -> str:
        if not isinstance(value, str) or value not in self.choices:
            raise FieldError(f"it must be one of {', '.join(self.choices)}", name)
        return value

    def schema(self) -> dict[str, Any]:
        """Return its JSON Schema."""
        return {"enum": list(self.choices), "default": self.default, "description": self.description}


_PART = Number("Square metres.")


@dataclass(frozen=True, slots=True)
class Covariance(Field):
    """Variance east, variance north, covariance of the two: a positive semidefinite matrix."""

    def check(self, name: str, value: object) -> tuple[float, float, float]:
        """Return the three numbers."""
        if not isinstance(value, list) or len(value) != 3:
            raise FieldError("it must be [variance east, variance north, covariance], square metres", name)
        east, north, both = (_PART.check(name, part) for part in value)
        if east < 0 or north < 0 or both**2 > east * north * (1 + 1e-6) + 1e-9:
            raise FieldError("it is not the covariance of a position", name)
        return east, north, both

    def schema(self) -> dict[str, Any]:
        """Return its JSON Schema."""
        return _three(_PART) | {"description": self.description}


_SIDE = Number("Metres.", 0, 1e6)


@dataclass(frozen=True, slots=True)
class Size(Field):
    """Three lengths."""

    def check(self, name: str, value: object) -> tuple[float, float, float]:
        """Return the three numbers."""
        if not isinstance(value, list) or len(value) != 3:
            raise FieldError("it must be [length, width, height], metres", name)
        length, width, height = (_SIDE.check(name, part) for part in value)
        return length, width, height

    def schema(self) -> dict[str, Any]:
        """Return its JSON Schema."""
        return _three(_SIDE) | {"description": self.description}


@dataclass(frozen=True, slots=True)
class ListOf(Field):
    """A list of objects with these fields."""

    fields: Mapping[str, Field]

    def check(self, name: str, value: object) -> list[dict[str, Any]]:
        if not isinstance(value, list) or not all(isinstance(part, Mapping) for part in value):
            raise FieldError("it must be a list of objects", name)
        return [check_fields(part, self.fields) for part in value]

    def schema(self) -> dict[str, Any]:
        """Return its JSON Schema."""
        return {"type": "array", "items": _object_schema(self.fields), "description": self.description}


_TRACK: dict[str, Field] = {
    "source": Choice("Each source has its own track.", SOURCES, "gps"),
    "track": Text("Name, where there are several tracks of one source.", least=0),
    "skipped": Number("Poses left out since the last one that was sent.", 0, 10**9, whole=True),
    "travelled_m": Number("Metres along the track, poses left out included; measured if missing.", 0),
}
_PLACE: dict[str, Field] = {
    "time": Number("Seconds since 1970, UTC.", required=True),
    "lat": Number("Degrees north, WGS 84.", -90, 90, required=True),
    "lon": Number("Degrees east, WGS 84.", -180, 180, required=True),
    "height_m": Number("Metres, as the robot counts them."),
    "covariance": Covariance("Variance east, variance north, covariance of the two; square metres."),
}

RECORDS: dict[str, dict[str, Field]] = {
    "pose": {
        **_PLACE,
        "heading_deg": Number("Degrees clockwise from north, where the robot looks."),
        **_TRACK,
    },
    "object": {
        "id": Text("The same for the same object at every sighting; without it the server associates."),
        "class": Text("`car`, `victim` ...", required=True),
        **_PLACE,
        "confidence": Number("0 to 1.", 0, 1),
        "size_m": Size("Length, width, height of the object; metres."),
        "photo": Text("SHA-256 of a photo of the mission.", least=64, most=64, pattern=_SHA256),
    },
    "status": {
        "time": _PLACE["time"],
        "track": Text("Name of the robot, as in its poses.", least=0),
        "battery_percent": Number("0 to 100.", 0, 100),
        "link_percent": Number("Quality of its radio link, 0 to 100.", 0, 100),
        "mode": Text("`auto`, `manual`, `return` ..."),
        "text": Text("A message to people."),
    },
    "end": {"left_out": ListOf("Of tracks whose last poses were left out.", _TRACK)},
}
"""The fields of each type of record, without `type`."""


def check_record(record: object) -> tuple[str, dict[str, Any]]:
    """Check a record parsed from JSON; return its type and its fields. Raises FieldError.

    Returns:
        fields: Those present; null counts as missing. Numbers are floats, or ints if `whole`.
    """
    if not isinstance(record, Mapping):
        raise FieldError("a record must be an object with a type")
    type_ = record.get("type")
    if not isinstance(type_, str) or type_ not in RECORDS:
        raise FieldError(f"it must be one of {', '.join(RECORDS)}", "type")
    fields = dict(record)
    del fields["type"]
    return type_, check_fields(fields, RECORDS[type_])


def check_fields(given: Mapping[str, object], fields: Mapping[str, Field]) -> dict[str, Any]:
    """Check the fields of a record, or of a part of one. Raises FieldError."""
    checked: dict[str, Any] = {}
    for name, value in given.items():
        expected = fields.get(name)
        if expected is None:
            raise FieldError("unknown field", str(name)[:40])
        if value is not None:
            checked[name] = expected.check(name, value)
    for name, one in fields.items():
        if name not in checked and one.required:
            raise FieldError("it is missing", name)
    return checked


def record_schema() -> dict[str, Any]:
    """Return the JSON Schema of a record."""
    return {
        "oneOf": [_object_schema(fields, {"type": {"const": type_}}) for type_, fields in RECORDS.items()]
    }


def _three(part: Number) -> dict[str, Any]:
    return {"type": "array", "items": part.schema(), "minItems": 3, "maxItems": 3}


def _object_schema(fields: Mapping[str, Field], more: Mapping[str, Any] | None = None) -> dict[str, Any]:
    more = more or {}
    return {
        "type": "object",
        "required": [*more, *(name for name, one in fields.items() if one.required)],
        "properties": {**more, **{name: one.schema() for name, one in fields.items()}},
        "additionalProperties": False,
    }
