"""The log of all processes, on standard error: lines of text, or one JSON object per line for programs.

All messages pass through here, so that tokens and secret links are redacted. Lines carry the ids of the
request or job that a thread works for, also in processes that compute for it.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal, get_args

from webapp.telemetry import trace_id

Form = Literal["text", "json"]
FORMS: tuple[Form, ...] = get_args(Form)

REQUESTS = "webapp.requests"
"""Logger with a line for each request; silent in text logs, because pages send requests every second."""

_SECRETS = (
    (re.compile(r"(/(?:sign-in|shared|s|embed)/)[^/\s?\"']+"), r"\1..."),
    (re.compile(r"(/(?:shared-missions|m|phones|p)/)[\w-]{20,}"), r"\1..."),
    (re.compile(r"(Bearer\s+|expmap_)[\w.~+/=-]+", re.IGNORECASE), r"\1..."),
)


Id = str | int

_at_work: ContextVar[Mapping[str, Id]] = ContextVar("expmap_at_work")
_form: list[Form] = []
"""Form of this process's log; empty if it writes none."""


@dataclass(frozen=True, slots=True)
class Carried:
    """The state that a process computing for this one needs to write the same log."""

    form: Form | None = None
    at_work: Mapping[str, Id] = field(default_factory=dict)


@contextmanager
def at_work(**ids: Id) -> Iterator[None]:
    """Add ids such as `request` or `job` to the log lines that are written within the block."""
    before = _at_work.set({**_at_work.get({}), **ids})
    try:
        yield
    finally:
        _at_work.reset(before)


def carried() -> Carried:
    """Return the state to pass to `take_over` in another process."""
    return Carried(_form[0] if _form else None, dict(_at_work.get({})))


def take_over(carried: Carried) -> None:
    """Log in the form, and with the ids, of the process that this one computes for."""
    if carried.form is not None and not _form:
        log_to_stderr(carried.form)
    _at_work.set(carried.at_work)


class _Ids(logging.Filter):
    """Adds the ids that the thread works for to each record; it filters none out."""

    def filter(self, record: logging.LogRecord) -> bool:
        trace = trace_id()
        record.ids = {**_at_work.get({}), **({} if trace is None else {"trace": trace})}
        return True


class _Text(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        ids = "".join(f" [{name} {value}]" for name, value in getattr(record, "ids", {}).items())
        return without_secrets(super().format(record)) + ids


class _Json(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "process": record.process,
            "message": without_secrets(record.getMessage()),
            **getattr(record, "ids", {}),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["traceback"] = without_secrets(self.formatException(record.exc_info))
        return json.dumps(line, ensure_ascii=False)


def log_to_stderr(form: Form = "text") -> None:
    """Write the program's own messages, and warnings of libraries, to standard error.

    Args:
        form: "text" or "json". JSON has a line for each request and each job; each has `time`, `level`,
            `process` and `message`.
    """
    _form[:] = [form]
    handler = logging.StreamHandler()
    handler.addFilter(_Ids())
    handler.setFormatter(_Json() if form == "json" else _Text("%(asctime)s %(levelname)s %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    logging.getLogger("webapp").setLevel(logging.INFO)
    logging.getLogger(REQUESTS).setLevel(logging.INFO if form == "json" else logging.CRITICAL)


def without_secrets(text: str) -> str:
    """Redact tokens and the secret part of links."""
    for pattern, replacement in _SECRETS:
        text = pattern.sub(replacement, text)
    return text
