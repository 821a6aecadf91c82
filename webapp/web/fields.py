"""Fields of schemas that are stricter than marshmallow's."""

from __future__ import annotations

from typing import Any

import apiflask.fields

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
