"""Fields of schemas that are stricter than marshmallow's."""

from __future__ import annotations

from typing import Any

import apiflask.fields
from apiflask.validators import Range
from marshmallow import ValidationError

from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.texts import has_controls

_TEXTS = {"true": True, "1": True, "false": False, "0": False}


class Boolean(apiflask.fields.Boolean):
    """JSON's true and false, and no 0 or `"no"`; in forms and addresses `true`, `1`, `false` and `0`."""

    def _deserialize(self, value: Any, attr: str | None, data: Any, **options: Any) -> bool:
        if isinstance(value, bool):
            return value
        is_json = isinstance(data, dict)  # forms and addresses come as a view of many values
        if not is_json and isinstance(value, str) and value.lower() in _TEXTS:
            return _TEXTS[value.lower()]
        raise self.make_error("invalid", input=value)


class Number(apiflask.fields.Integer):
    """The number of a record or a revision: none is larger than a column can hold, on any database.

    Parameters
    ----------
    least : int
        -1 where it stands for "before the first one".
    """

    def __init__(self, *, least: int = 0, **options: Any) -> None:
        super().__init__(validate=Range(least, MAX_NUMBER), **options)


def no_controls(text: str) -> None:
    """Refuse control characters in a line that people write; a validator."""
    if has_controls(text):
        raise ValidationError("This has control characters.")
