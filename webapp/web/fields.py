"""Fields of schemas that are stricter than marshmallow's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import apiflask.fields
from apiflask.validators import Range

from webapp.core.mapmodel.checks import MAX_NUMBER

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


class RecordNumber(apiflask.fields.Integer):
    """The number of a record or a revision: none is larger than a column can hold, on any database.

    Parameters
    ----------
    least : int
        -1 where it stands for "before the first one".
    """

    def __init__(self, *, least: int = 0, **options: Any) -> None:
        super().__init__(validate=Range(least, MAX_NUMBER), **options)


class CheckedText(apiflask.fields.String):
    """A text that a check accepts.

    Parameters
    ----------
    check : callable
        Returns whether it can be used.
    refusal : str
        What is said of others.
    """

    def __init__(self, *, check: Callable[[str], bool], refusal: str, **options: Any) -> None:
        super().__init__(error_messages={"refused": refusal}, **options)
        self._check = check

    def _deserialize(self, value: Any, attr: str | None, data: Any, **options: Any) -> str:
        text = str(super()._deserialize(value, attr, data, **options))
        if not self._check(text):
            raise self.make_error("refused")
        return text
