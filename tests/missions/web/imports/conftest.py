"""A mission, and a worker for queued jobs."""

import pytest

from webapp.app.registry import REGISTRY
from webapp.jobs.context import Context, JobProgress
from webapp.missions.store import missions
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease, Limits


@pytest.fixture
def mission(library, owner):
    """Make a mission and return its id."""
    with library.database.write() as session:
        return missions.create(session, "Yard", account_id=owner.id).id


@pytest.fixture
def work(library, settings):
    """Run the queued job as a worker does, and return its result."""

    def go(**limits):
        with library.database.write() as session:
            job = jobs.lease(session, "test", limits=Limits(limits.get("seconds", 60), 3))
            lease, function = Lease(job.id, job.fence), REGISTRY.function(job.kind)
            known = (job.map_id, job.account_id, job.arguments)
        return function(Context(library, settings, JobProgress(), lease, *known))

    return go
