"""Metrics of the server for Prometheus: `/metrics`, if the settings have a token for it.

The web processes share their counters by files of the client library, in a folder that the supervisor makes
for them (`PROMETHEUS_MULTIPROC_DIR`). Database and disk are read at each scrape.
"""

from __future__ import annotations

import hmac
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from typing import Any

from flask import Blueprint, Flask, Response, current_app, g, request
from flask.sansio.app import App

from webapp.errors import NotFound, StorageError
from webapp.extras import extra
from webapp.files.contents import in_use
from webapp.files.object_storage.bucket import Operation, watch
from webapp.settings import shares_metrics
from webapp.store.library import Library
from webapp.store.operate import job_views
from webapp.web.context import library, public, settings
from webapp.web.state import KEY

blueprint = Blueprint("metrics", __name__)

_EXTENSION = "expmap_metrics"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_SECONDS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Upper bounds of the histograms' buckets."""


def init_app(app: Flask) -> None:
    """Register the counting of requests, if the settings have a token."""
    if app.extensions[KEY].settings.serve.metrics_token is not None:
        app.extensions[_EXTENSION] = counted = _Metrics()
        watch(counted)
        app.after_request(_count_request)


def count_answer(seconds: Mapping[str, float | None]) -> None:
    """Record the durations of the stages of an answer to a query."""
    counted: _Metrics | None = current_app.extensions.get(_EXTENSION)
    if counted is not None:
        for stage, took in seconds.items():
            if took is not None:
                counted.stage_seconds.labels(stage).observe(took)


def look_counter(app: App) -> Callable[[bool], None]:
    """Make a function that counts hits and misses of the cache of open maps."""
    counted: _Metrics | None = app.extensions.get(_EXTENSION)

    def count(was_open: bool) -> None:
        if counted is not None:
            counted.looks.labels("open" if was_open else "opened").inc()

    return count


@blueprint.get("/metrics")
@public
def show() -> Response:
    """Send the metrics to callers with the token."""
    token = settings().serve.metrics_token
    if token is None:
        raise NotFound("this server gives no metrics", hint="set serve.metrics_token")
    sent = request.headers.get("Authorization", "").encode()
    if not hmac.compare_digest(sent, f"Bearer {token}".encode()):
        refused = Response("the token is missing or wrong\n", HTTPStatus.UNAUTHORIZED, mimetype="text/plain")
        refused.headers["WWW-Authenticate"] = "Bearer"
        return refused
    metrics: _Metrics = current_app.extensions[_EXTENSION]
    return Response(metrics.text(library()), content_type=metrics.content_type)


class _Metrics:
    """Counters and histograms."""

    def __init__(self) -> None:
        with extra("cluster"):
            import prometheus_client
            from prometheus_client import multiprocess
            from prometheus_client.core import GaugeMetricFamily
        self._client, self._multiprocess, self._gauge = prometheus_client, multiprocess, GaugeMetricFamily
        self._registry = registry = prometheus_client.CollectorRegistry()
        self.content_type: str = prometheus_client.CONTENT_TYPE_LATEST
        self.requests = prometheus_client.Counter(
            "expmap_requests", "Answered requests.", ["method", "route", "status"], registry=registry
        )
        self.request_seconds = prometheus_client.Histogram(
            "expmap_request_seconds",
            "Until the answer begins.",
            ["route"],
            registry=registry,
            buckets=_SECONDS,
        )
        self.looks = prometheus_client.Counter(
            "expmap_map_cache", "Lookups in the cache of open maps, by result.", ["result"], registry=registry
        )
        self.stage_seconds = prometheus_client.Histogram(
            "expmap_answer_seconds",
            "Stages of answers to where a photo was taken.",
            ["stage"],
            registry=registry,
            buckets=_SECONDS,
        )

        self.storage_requests = prometheus_client.Counter(
            "expmap_storage_requests",
            "Requests to the object storage; objects count once, also in pieces.",
            ["operation", "result"],
            registry=registry,
        )
        self.storage_seconds = prometheus_client.Histogram(
            "expmap_storage_seconds",
            "Requests to the object storage.",
            ["operation"],
            registry=registry,
            buckets=_SECONDS,
        )
        self.storage_looks = prometheus_client.Counter(
            "expmap_storage_cache",
            "Looks for an object in the cache of this machine, by what was found.",
            ["result"],
            registry=registry,
        )

    def asked(self, operation: Operation, seconds: float, *, failed: bool) -> None:
        """Count a request to the object storage."""
        self.storage_requests.labels(operation, "failed" if failed else "done").inc()
        self.storage_seconds.labels(operation).observe(seconds)

    def looked_up(self, *, found: bool) -> None:
        """Count a lookup of an object in the cache."""
        self.storage_looks.labels("hit" if found else "miss").inc()

    def text(self, place: Library) -> bytes:
        """Return all metrics in Prometheus's text format."""
        counted = self._registry
        if shares_metrics():
            counted = self._client.CollectorRegistry()
            self._multiprocess.MultiProcessCollector(counted)  # type: ignore[no-untyped-call]
        now = self._client.CollectorRegistry()
        now.register(_Now(place, self._gauge))
        text: bytes = self._client.generate_latest(counted) + self._client.generate_latest(now)
        return text


class _Now:
    """Collector of values read at each scrape; `gauge` makes a metric from name, description and value."""

    def __init__(self, place: Library, gauge: Callable[[str, str, float], Any]) -> None:
        self._library, self._gauge = place, gauge

    def collect(self) -> Iterator[Any]:
        """Yield the metrics of the database, the cache and the disk."""
        try:
            with self._library.database.read() as session:
                queue = job_views.queue_figures(session)
        except StorageError:
            yield self._gauge("expmap_database_up", "Whether the database answers.", 0)
        else:
            yield self._gauge("expmap_database_up", "Whether the database answers.", 1)
            yield self._gauge("expmap_jobs_waiting", "Jobs in the queue.", queue.waiting)
            yield self._gauge("expmap_jobs_running", "Jobs with a lease.", queue.running)
            yield self._gauge(
                "expmap_leases_ended", "Jobs whose worker has not renewed its lease.", queue.abandoned
            )
            oldest = "How long the first job of the queue waits."
            yield self._gauge("expmap_jobs_oldest_seconds", oldest, queue.oldest_s)
        storage = in_use()
        if storage is not None:
            cached = "Objects in the cache of this machine, as of the last minute."
            yield self._gauge("expmap_storage_cache_bytes", cached, storage.cache.recent_size())
        try:
            disk = shutil.disk_usage(self._library.folder)
        except OSError:
            return  # a missing folder has no size; other metrics show the failure
        yield self._gauge("expmap_disk_size_bytes", "Of the library's disk.", disk.total)
        yield self._gauge("expmap_disk_free_bytes", "Of the library's disk.", disk.free)


def _count_request(response: Response) -> Response:
    metrics: _Metrics = current_app.extensions[_EXTENSION]
    route = "none" if request.url_rule is None else request.url_rule.rule
    method = request.method if request.method in _METHODS else "other"  # clients can send any method
    metrics.requests.labels(method, route, response.status_code).inc()
    if "expmap_begun" in g:
        metrics.request_seconds.labels(route).observe(time.perf_counter() - g.expmap_begun)
    return response
