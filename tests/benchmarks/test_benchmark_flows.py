"""How `benchmarks.flows` records requests."""

import threading
from datetime import datetime

import pytest

from benchmarks import flows
from webapp.threads import in_threads

pytestmark = pytest.mark.slow


def test_calls_are_noted_with_the_modules_of_both_sides():
    with flows.traced() as calls:
        in_threads(str, [1])
        datetime(2024, 5, 1)
    assert set(calls) == {("", "webapp.threads"), ("webapp.threads", "webapp.threads")}
    before = len(calls)
    in_threads(str, [1])
    assert len(calls) == before


def test_calls_in_new_threads_are_noted():
    with flows.traced() as calls:
        thread = threading.Thread(target=in_threads, args=(str, [1]))
        thread.start()
        thread.join()
    assert ("", "webapp.threads") in calls


def test_a_moved_photo_is_followed(tmp_path):
    program = flows.Program(tmp_path / "maps")
    flow = flows.follow("move 3", flows.moves(program, photos=3), repeat=2)
    assert "webapp.settings" not in flow.modules
    assert len(flow.modules) > 5
    assert flow.crossings == sum(count for _, _, count in flow.pairs) > 10
    assert all(caller != callee for caller, callee, _ in flow.pairs)
    assert 0 < flow.fastest_ms <= flow.median_ms
    assert "move 3" in flows.as_text([flow])
