"""Requests of `benchmarks.hostile` are determined by its seed; responses that count as faults."""

import io
import json
import random
import subprocess
import sys
import zipfile

import pytest

from benchmarks import hostile, hostile_inputs, hostile_json
from benchmarks.memory import PeakMemory

DOCUMENT = {
    "paths": {
        "/api/v1/maps/{slug}/photos/{id}": {
            "patch": {
                "parameters": [
                    {"name": "slug", "in": "path", "schema": {"type": "string"}},
                    {"name": "id", "in": "path", "schema": {"type": "integer"}},
                ],
                "requestBody": {
                    "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Change"}}}
                },
            }
        }
    },
    "components": {"schemas": {"Change": {"type": "object", "properties": {"x_px": {"type": "number"}}}}},
}
KNOWN = {"slug": "target", "id": 3, "mission_id": 1, "phone": "t"}


def requests(seed, count=60):
    numbers = range(count)
    return [hostile.make_request(seed, n, document=DOCUMENT, known=KNOWN) for n in numbers]


def is_json(data):
    try:
        json.loads(data)
    except (ValueError, RecursionError):
        return False
    return True


@pytest.mark.slow
def test_a_request_follows_from_its_seed_and_number():
    assert requests(1) == requests(1)
    assert requests(1) != requests(2)


@pytest.mark.slow
def test_all_kinds_are_sent_and_most_addresses_exist():
    found = requests(3, 300)
    kinds = {kind for kind, _ in found}
    assert kinds >= {"api", "photo", "satellite", "zip", "mission", "crs", "positions"}
    assert kinds >= {"json", "bomb", "preview", "crowded-zip", "crowded-list"}
    assert kinds >= {"package", "drawings", "drawing", "phone"}
    api = [request for kind, request in found if kind == "api"]
    assert all(request.method == "PATCH" and "{" not in request.path for request in api)
    assert sum(request.path == "/maps/target/photos/3" for request in api) > len(api) / 2


def test_json_is_sent_that_cannot_be_read_or_is_long():
    made = [hostile_json.json_request(random.Random(n), DOCUMENT, known=KNOWN) for n in range(50)]
    assert {(request.method, request.path) for request in made} == {("PATCH", "/maps/target/photos/3")}
    found = [request.raw for request in made]
    assert max(map(len, found)) > 10_000_000
    short = [data for data in found if len(data) < 100_000]
    assert 0 < sum(map(is_json, short)) < len(short)


def test_some_zips_can_be_opened_and_some_cannot():
    opened = sum(zipfile.is_zipfile(io.BytesIO(hostile_inputs.map_zip(random.Random(n)))) for n in range(40))
    assert 5 < opened < 40


@pytest.mark.parametrize(
    ("status", "headers", "fault"),
    [
        (200, {}, False), (422, {}, False), (500, {}, True), (502, {}, True), (503, {}, True),
        (503, {"Retry-After": "1"}, False), (507, {}, False),
    ],
)  # fmt: skip
def test_a_fault_is_what_only_the_server_can_be_blamed_for(status, headers, fault):
    assert hostile.is_fault(status, headers) is fault


def test_the_slowest_request_of_a_kind_is_named():
    tally = hostile.Tally()
    for seconds, request in [
        (0.2, "api 1: GET /maps"),
        (3.0, "api 2: POST /maps"),
        (0.1, "api 3: GET /jobs"),
    ]:
        tally.note("api", 200, seconds=seconds, request=request)
    assert tally.slowest == {"api": (3.0, "api 2: POST /maps")}
    assert tally.statuses == {"api 200": 3}


def test_the_greatest_memory_of_a_process_over_idle_is_found():
    grow = "input(); kept = bytearray(90_000_000); print(len(kept), flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", grow], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        memory = PeakMemory(process.pid)
        memory.look()
        assert memory.most_mb < 20
        print("go", file=process.stdin, flush=True)
        assert process.stdout.readline() == "90000000\n"
        memory.look()
        process.communicate("end")
    assert 60 < memory.most_mb < 110
    assert grow in memory.process
