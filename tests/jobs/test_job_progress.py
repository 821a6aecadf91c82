"""Progress of a job fills one bar over all its stages."""

import pytest

from webapp.errors import Cancelled
from webapp.jobs.context import JobProgress


def test_stages_add_up():
    progress = JobProgress()
    assert progress.state() == (0, 0, "")
    progress.plan(500, 200)
    assert progress.state() == (0, 700, "")
    progress.note("first")
    progress.size(10)
    progress.advance(4)
    assert progress.state() == (4, 210, "first")
    progress.size(150)
    assert progress.state() == (10, 160, "first")
    progress.advance(150)
    assert progress.state() == (160, 160, "first")


def test_a_stage_without_a_plan_is_added():
    progress = JobProgress()
    progress.size(3)
    progress.advance(9)
    progress.size(2)
    progress.advance()
    assert progress.state()[:2] == (4, 5)


def test_steps_of_an_earlier_run_are_left_out():
    progress = JobProgress()
    progress.skip()  # before the first stage: nothing
    progress.size(10)
    progress.skip(6)
    progress.advance()
    assert progress.state()[:2] == (1, 4)
    progress.skip(9)
    assert progress.state()[:2] == (0, 0)


def test_it_stops_when_asked():
    progress = JobProgress()
    progress.check()
    progress.stop()
    with pytest.raises(Cancelled):
        progress.check()
