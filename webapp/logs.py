"""The log of all processes, on standard error: lines for people, or one JSON object a line for programs.

Whatever goes there passes through here, so that no token and no link that lets somebody in can be read in it.
Lines carry the ids of the request or the job that a thread works for, also in processes that compute for it.
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
"""Logger with a line for each request; people see none of them, as pages ask every second."""

_SECRETS = (
    (re.compile(r"(/(?:sign-in|shared|s|embed)/)[^/\s?\"']+"), r"\1..."),
    (re.compile(r"(Bearer\s+|expmap_)[\w.~+/=-]+", re.IGNORECASE), r"\1..."),
)


Id = str | int

_at_work: ContextVar[Mapping[str, Id]] = ContextVar("expmap_at_work")
_form: list[Form] = []
"""Of this process, where it writes a log."""


@dataclass(frozen=True, slots=True)
class Carried:
    """What a process that computes for this one has to know to write the same log."""

    form: Form | None = None
    at_work: Mapping[str, Id] = field(default_factory=dict)


@contextmanager
def at_work(**ids: Id) -> Iterator[None]:
    """Let lines of the log carry these ids in the block, such as `request` or `job`."""
    before = _at_work.set({**_at_work.get({}), **ids})
    try:
        yield
    finally:
        _at_work.reset(before)


def carried() -> Carried:
    """Return what another process needs for `take_over`."""
    return Carried(_form[0] if _form else None, dict(_at_work.get({})))


def take_over(carried: Carried) -> None:
    """Write the log of this process as that which it computes for."""
    if carried.form is not None and not _form:
        log_to_stderr(carried.form)
    _at_work.set(carried.at_work)


class _Ids(logging.Filter):
    """Notes what the thread works for that writes a line; it refuses none."""

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

    Parameters
    ----------
    form : {"text", "json"}
        JSON has a line for each request and each job, with `time`, `level`, `process` and `message` in all.
    """
    _form[:] = [form]
    handler = logging.StreamHandler()
    handler.addFilter(_Ids())
    handler.setFormatter(_Json() if form == "json" else _Text("%(asctime)s %(levelname)s %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    logging.getLogger("webapp").setLevel(logging.INFO)
    logging.getLogger(REQUESTS).setLevel(logging.INFO if form == "json" else logging.CRITICAL)


def without_secrets(text: str) -> str:
    """Blank out tokens, and links that let somebody in."""
    for pattern, replacement in _SECRETS:
        text = pattern.sub(replacement, text)
    return text
