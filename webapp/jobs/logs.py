"""The log of all processes, on standard error: lines for people, or one JSON object a line for programs.

Whatever goes there passes through here, so that no token and no link that lets somebody in can be read in it.
"""

from __future__ import annotations

import json
import logging
import re
from datetime import UTC, datetime
from typing import Literal, get_args

Form = Literal["text", "json"]
FORMS: tuple[Form, ...] = get_args(Form)

REQUESTS = "webapp.requests"
"""Logger with a line for each request; people see none of them, as pages ask every second."""

_SECRETS = (
    (re.compile(r"(/(?:sign-in|shared|s|embed)/)[^/\s?\"']+"), r"\1..."),
    (re.compile(r"(Bearer\s+|expmap_)[\w.~+/=-]+", re.IGNORECASE), r"\1..."),
)


class _Text(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return without_secrets(super().format(record))


class _Json(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "process": record.process,
            "message": without_secrets(record.getMessage()),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["traceback"] = without_secrets(self.formatException(record.exc_info))
        return json.dumps(line, ensure_ascii=False)


def log_to_stderr(form: Form = "text") -> None:
    """Write the program's own messages, and warnings of libraries, to standard error.

    Parameters
    ----------
    form : {"text", "json"}
        JSON has a line for each request and each job, with `time`, `level`, `process` and `message` in all.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(_Json() if form == "json" else _Text("%(asctime)s %(levelname)s %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    logging.getLogger("webapp").setLevel(logging.INFO)
    logging.getLogger(REQUESTS).setLevel(logging.INFO if form == "json" else logging.CRITICAL)


def without_secrets(text: str) -> str:
    """Blank out tokens, and links that let somebody in."""
    for pattern, replacement in _SECRETS:
        text = pattern.sub(replacement, text)
    return text
