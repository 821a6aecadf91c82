"""Traces for OpenTelemetry: spans of requests, jobs and the stages of an answer.

Nothing is recorded, and no package is loaded, unless the setting `traces` says where spans are sent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from webapp import __version__
from webapp.extras import extra

_NAME = "experience-map"


@dataclass(frozen=True, slots=True)
class _Recorder:
    """What records spans, and functions of OpenTelemetry."""

    tracer: Any
    extract: Callable[[Mapping[str, str]], Any]
    current: Callable[[], Any]


_recorders: list[_Recorder] = []
"""Of this process; one at most."""


def start(address: str | None) -> None:
    """Send spans to a collector from now on; call it once a process, after forks.

    Parameters
    ----------
    address : str or None
        Where it takes OTLP by HTTP, such as `http://127.0.0.1:4318`; None: nothing is recorded.

    Raises
    ------
    MissingPart
        The extra `telemetry` is not installed.
    """
    if _recorders or address is None:
        return
    with extra("telemetry"):
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import OTELResourceDetector, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    own = Resource({"service.name": _NAME, "service.version": __version__})
    provider = TracerProvider(resource=own.merge(OTELResourceDetector().detect()))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(f"{address.rstrip('/')}/v1/traces")))
    use(provider)


def use(provider: Any | None) -> None:
    """Record spans by a `TracerProvider` of OpenTelemetry; None: no more."""
    _recorders.clear()
    if provider is None:
        return
    with extra("telemetry"):
        from opentelemetry.propagate import extract
        from opentelemetry.trace import get_current_span
    _recorders.append(_Recorder(provider.get_tracer(_NAME, __version__), extract, get_current_span))


@contextmanager
def span(name: str, *, headers: Mapping[str, str] | None = None, **attributes: str | int) -> Iterator[Any]:
    """Record the block as a span; gives that, or None where nothing is recorded.

    Parameters
    ----------
    headers : mapping of str to str, optional
        Of a request, whose `traceparent` may name the span that this one is part of.
    """
    if not _recorders:
        yield None
        return
    (recorder,) = _recorders
    context = None if headers is None else recorder.extract({k.lower(): v for k, v in headers.items()})
    kept = {f"expmap.{key}": value for key, value in attributes.items()}
    with recorder.tracer.start_as_current_span(name, context=context, attributes=kept) as recorded:
        yield recorded


def trace_id() -> str | None:
    """Return the id of the trace that this thread works for, as logs and tools show it."""
    if not _recorders:
        return None
    found = _recorders[0].current().get_span_context()
    return f"{found.trace_id:032x}" if found.is_valid else None
