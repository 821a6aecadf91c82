"""Log lines and spans carry the id of their request or job, across threads and processes."""

import logging
import sys

import pytest

from tests.web.test_request_log import lines, stderr  # noqa: F401 - fixtures
from webapp import telemetry
from webapp.errors import MissingPart
from webapp.logs import at_work, carried, log_to_stderr, take_over
from webapp.settings import Settings
from webapp.threads import ContextThreads, in_threads

_log = logging.getLogger("webapp.tests")


@pytest.fixture
def spans():
    """The recorded spans, in OpenTelemetry's exporter for tests."""
    trace = pytest.importorskip("opentelemetry.sdk.trace")
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    exporter, provider = InMemorySpanExporter(), trace.TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    telemetry.use(provider)
    yield exporter.get_finished_spans
    telemetry.use(None)


def test_a_request_has_the_id_that_a_proxy_gave_it(client, park, lines):  # noqa: F811
    answer = client.get(f"/api/v1/maps/{park}", headers={"X-Request-ID": "proxy-7"})
    (line,) = lines()
    assert answer.headers["X-Request-ID"] == line["request"] == "proxy-7"


@pytest.mark.parametrize("given", ["", "two words", "x" * 65, "a/b"])
def test_without_a_usable_one_it_gets_its_own(client, park, lines, given):  # noqa: F811
    answers = [client.get(f"/api/v1/maps/{park}", headers={"X-Request-ID": given}) for _ in range(2)]
    first, second = (answer.headers["X-Request-ID"] for answer in answers)
    assert first != second and len(first) == 16 and given not in (first, second)
    assert [line["request"] for line in lines()] == [first, second]


def test_threads_and_other_processes_write_for_the_same_job(lines):  # noqa: F811
    with at_work(job=12):
        in_threads(lambda n: _log.warning("part %d", n), [1, 2])
        with ContextThreads(1) as pool:
            pool.submit(_log.warning, "other").result()
        there = carried()
    _log.warning("idle")
    assert [line.get("job") for line in lines()] == [12, 12, 12, None]
    assert (there.form, dict(there.at_work)) == ("json", {"job": 12})
    with ContextThreads(1) as pool:  # like another process
        pool.submit(take_over, there).result()


@pytest.fixture
def text(stderr):  # noqa: F811
    """The log in the format for people."""
    log_to_stderr("text")
    return stderr.getvalue


def test_people_read_it_at_the_end_of_the_line(text):
    with at_work(job=12):
        _log.warning("the disk is slow")
    assert text().endswith("WARNING the disk is slow [job 12]\n")


def test_a_request_is_a_span_of_the_trace_that_it_came_with(client, park, lines, spans):  # noqa: F811
    trace = "0af7651916cd43dd8448eb211c80319c"
    client.get(f"/api/v1/maps/{park}", headers={"Traceparent": f"00-{trace}-b7ad6b7169203331-01"})
    (span,) = spans()
    assert span.name == "GET /api/v1/maps/<slug>"
    assert format(span.context.trace_id, "032x") == trace
    assert span.attributes["http.response.status_code"] == 200
    (line,) = lines()
    assert (line["trace"], line["request"]) == (trace, span.attributes["expmap.request"])


def test_parts_of_a_span_are_below_it_in_other_threads_too(spans):
    def part(name):
        with telemetry.span(name):
            pass

    with telemetry.span("whole", job=3):
        in_threads(part, ["left", "right"])
    *parts, whole = spans()
    assert {one.name for one in parts} == {"left", "right"} and whole.attributes["expmap.job"] == 3
    assert {one.parent.span_id for one in parts} == {whole.context.span_id}


def test_nothing_is_recorded_unless_a_setting_says_where_it_goes():
    telemetry.start(Settings().traces)
    with telemetry.span("nothing") as span:
        assert span is None and telemetry.trace_id() is None


def test_what_is_missing_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(MissingPart, match="traces for OpenTelemetry") as caught:
        telemetry.start("http://127.0.0.1:4318")
    assert caught.value.hint == "pip install 'experience-map[telemetry]'"
