"""A field of a JSON file with its path, so that errors state its location."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from webapp.errors import MapJsonError

T = TypeVar("T")
_NAMES = {
    dict: "an object",
    list: "a list",
    str: "text",
    bool: "true or false",
    int: "a number",
    float: "a number",
}


_HALF = re.compile(r"\\u[dD][89a-fA-F]")
"""The escape of half of a surrogate pair, if no other follows."""


@dataclass(frozen=True, slots=True)
class JsonField:
    """A value, its JSON path (`$.experiences[3].fov_deg`) and its file.

    A field that is absent, or null, has the value None and is `missing`.
    """

    value: object
    path: str
    where: str

    @property
    def missing(self) -> bool:
        """Whether the field is absent or null."""
        return self.value is None

    def error(self, message: str, *, hint: str | None = None) -> MapJsonError:
        """Return (do not raise) an error that says: this field `message`."""
        return MapJsonError(f"{self.path} {message}", where=self.where, hint=hint)

    def record(self, *, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, JsonField]:
        """Return the fields of an object by name, absent optional ones included.

        Raises:
            MapJsonError: The value is not an object, a required field is missing, or a field is unknown.
        """
        if not isinstance(self.value, dict):
            raise self._wrong("an object")
        unknown = [name for name in self.value if name not in (*required, *optional)]
        if unknown:
            names = ", ".join((*required, *optional))
            raise self.error(f"has an unknown field {unknown[0][:60]!r}", hint=f"the fields are {names}")
        fields = {name: self._child(self.value.get(name), f".{name}") for name in (*required, *optional)}
        for name in required:
            if fields[name].missing:
                raise fields[name].error("is missing", hint="add it")
        return fields

    def items(self) -> list[JsonField]:
        if self.missing:
            return []
        if not isinstance(self.value, list):
            raise self._wrong("a list")
        return [self._child(item, f"[{i}]") for i, item in enumerate(self.value)]

    def integer(self, *, largest: int, smallest: int = 0, default: int | None = None) -> int:
        """Return a whole number within limits, or the default if the field is missing.

        Raises MapJsonError.
        """
        if self.missing and default is not None:
            return default
        if not isinstance(self.value, int) or isinstance(self.value, bool):
            raise self._wrong("a whole number")
        if not smallest <= self.value <= largest:
            raise self.error(f"is not from {smallest} to {largest}")
        return self.value

    def number(self, meaning: str, *, valid: Callable[[float], bool]) -> float:
        """Return a finite number for which `valid` holds; `meaning` describes valid numbers in the error.

        Raises MapJsonError.
        """
        if not isinstance(self.value, int | float) or isinstance(self.value, bool):
            raise self._wrong("a number")
        if not abs(self.value) < 1e300 or not valid(float(self.value)):
            raise self.error(f"is not {meaning}")
        return float(self.value)

    def pixels(self) -> float:
        """Return a finite number of pixels. Raises MapJsonError."""
        return self.number("a finite number of pixels", valid=finite)

    def boolean(self) -> bool:
        """Return true or false. Raises MapJsonError."""
        if not isinstance(self.value, bool):
            raise self._wrong("true or false")
        return self.value

    def text(self) -> str:
        """Return a text. Raises MapJsonError."""
        if not isinstance(self.value, str):
            raise self._wrong("text")
        return self.value

    def _child(self, value: object, step: str) -> JsonField:
        return JsonField(value, self.path + step, self.where)

    def _wrong(self, wanted: str) -> MapJsonError:
        if self.missing:
            return self.error("is missing", hint=f"give {wanted}")
        return self.error(f"must be {wanted}, not {_NAMES[type(self.value)]}")


def finite(value: float) -> bool:
    return math.isfinite(value)


def most_values_in(data: bytes) -> int:
    """Return an upper limit of the number of values in JSON, without parsing it."""
    return 1 + sum(map(data.count, (b",", b"[", b"{")))


def parse_json(data: bytes, *, where: str, most_values: int | None = None) -> JsonField:
    """Parse JSON in UTF-8, with or without a byte order mark.

    NaN, duplicate fields and texts that cannot be encoded are errors.

    Args:
        most_values: Limit of the number of values, each of which takes some 150 bytes of memory.

    Raises:
        MapJsonError: The JSON is invalid; syntax errors have line and column.
    """

    def refuse_constant(name: str) -> object:
        raise MapJsonError(f"{name} is not a JSON number", where=where, hint="leave out what is unknown")

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        fields = dict(pairs)
        if len(fields) < len(pairs):
            twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
            raise MapJsonError(f"duplicate field {twice[:60]!r} in one object", where=where, hint="keep one")
        return fields

    if most_values is not None and most_values_in(data) > most_values:
        raise MapJsonError(
            f"it has more than {most_values} values", where=where, hint="divide it into several files"
        )
    try:
        text = data.decode("utf-8-sig")
        value = json.loads(text, object_pairs_hook=unique, parse_constant=refuse_constant)
        if _HALF.search(text) and not _is_unicode(value):
            raise MapJsonError("a text has half of a surrogate pair", where=where, hint="correct it")
        return JsonField(value, "$", where)
    except UnicodeDecodeError as error:
        message = f"the byte at offset {error.start} is not UTF-8"
        raise MapJsonError(message, where=where, hint="save the file as UTF-8") from error
    except json.JSONDecodeError as error:
        place = f"{where}:{error.lineno}:{error.colno}"
        raise MapJsonError(f"this is not JSON: {error.msg}", where=place, hint="restore the file") from error
    except (ValueError, RecursionError) as error:
        raise MapJsonError("this JSON has a number too long or is nested too deep", where=where) from error


def _is_unicode(value: object) -> bool:
    """Return whether all texts, names of fields included, can be encoded."""
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True


def by_id(field: JsonField, *, parse: Callable[[JsonField], tuple[int, T]]) -> dict[int, T]:
    found: dict[int, T] = {}
    for item in field.items():
        id, value = parse(item)
        if id in found:
            raise item.error(f"has the id {id} of an earlier item", hint="keep one of the two")
        found[id] = value
    return found
