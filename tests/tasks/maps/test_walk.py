"""The walk through a map's photos, planned once for all who ask at the same time."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

from webapp.core.mapmodel.walk import Stop
from webapp.tasks.maps import walk


def test_those_who_ask_at_the_same_time_get_one_plan(monkeypatch):
    planned, plan, together = [], walk.plan_walk, Barrier(4)

    def slowly(stops):
        planned.append(stops)
        return plan(stops)

    def ask(_):
        stops = tuple(Stop(n, 10.0 * n, 0.125) for n in range(300))
        together.wait(10)
        return walk.walk_along(stops)

    monkeypatch.setattr(walk, "plan_walk", slowly)
    with ThreadPoolExecutor(4) as threads:
        walks = [*threads.map(ask, range(4))]
    assert len(planned) == 1
    assert all(one is walks[0] for one in walks)
