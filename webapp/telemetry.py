"""OpenTelemetry traces: spans of requests, jobs and the stages of an answer.

Nothing is recorded, and no package is loaded, unless the setting `traces` is given.
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
    """A tracer, and functions of OpenTelemetry."""

    tracer: Any
    extract: Callable[[Mapping[str, str]], Any]
    current: Callable[[], Any]


_recorders: list[_Recorder] = []
"""The recorder of this process; at most one."""


def start(address: str | None) -> None:
    """Start sending spans to a collector; to be called once per process, after forking.

    Args:
        address: Its OTLP/HTTP endpoint, such as `http://127.0.0.1:4318`; None: nothing is recorded.
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
    """Record spans with an OpenTelemetry `TracerProvider`; None stops recording."""
    _recorders.clear()
    if provider is None:
        return
    with extra("telemetry"):
        from opentelemetry.propagate import extract
        from opentelemetry.trace import get_current_span
    _recorders.append(_Recorder(provider.get_tracer(_NAME, __version__), extract, get_current_span))


@contextmanager
def span(name: str, *, headers: Mapping[str, str] | None = None, **attributes: str | int) -> Iterator[Any]:
    """Record the block as a span; yields the span, or None if nothing is recorded.

    Args:
        headers: Headers of a request, whose `traceparent` may name the parent span.
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
    """Return the hexadecimal id of this thread's current trace, if there is one."""
    if not _recorders:
        return None
    found = _recorders[0].current().get_span_context()
    return f"{found.trace_id:032x}" if found.is_valid else None
