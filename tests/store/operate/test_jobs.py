"""Jobs: the queue, leases, fences, and their state on pages."""

import threading
from datetime import timedelta

import pytest
import sqlalchemy
from sqlalchemy import select

from webapp.errors import Conflict, NotFound
from webapp.store import clock
from webapp.store.operate import job_views, jobs
from webapp.store.operate.jobs import Lanes, Lease, Limits
from webapp.store.schema import Account, Edit, Job, MapRecord

LIMITS = Limits(seconds=10.0, attempts=3)
LANES = Lanes(frozenset({"export", "tiles"}))
SHORT = Lanes(LANES.short, only_short=True)
ERROR = {"message": "no", "where": None, "hint": None}


@pytest.fixture
def at(monkeypatch):
    """Set the clock of the jobs, and return a function that advances it by seconds."""
    time = [clock.now()]
    for module in (jobs, job_views):
        monkeypatch.setattr(module, "moment", lambda _: time[0])

    def later(seconds):
        time[0] += timedelta(seconds=seconds)

    return later


@pytest.fixture
def do(library):
    """Call a function of `jobs` in a separate session."""

    def call(function, *arguments, **named):
        with library.database.write() as session:
            return function(session, *arguments, **named)

    return call


@pytest.fixture
def take(do):
    """Take the next job, and return its lease."""

    def call(who="a", **named):
        job = do(jobs.lease, who, limits=LIMITS, **named)
        return job and Lease(job.id, job.fence)

    return call


@pytest.fixture
def park(new_account, new_map):
    return new_map(new_account("ana"))


@pytest.fixture
def seen(do):
    """Return the job as pages get it."""
    return lambda id: do(lambda session: job_views.to_json(session, jobs.find(session, id)))


def ask(do, id):
    """A photo is sent that waits for a job."""
    do(lambda session: jobs.ask(session, jobs.find(session, id)))


def test_two_waiting_jobs_of_one_kind_are_one(do, take, park):
    first = do(jobs.enqueue, "index", map_id=park, key="x")
    assert do(jobs.enqueue, "index", map_id=park, key="x").id == first.id
    others = [
        do(jobs.enqueue, "index", map_id=park, key="y").id,
        do(jobs.enqueue, "export", map_id=park, key="x").id,
        do(jobs.enqueue, "index", key="x").id,
    ]
    assert len({first.id, *others}) == 4
    assert do(jobs.enqueue, "index", key="x").id == others[-1]
    assert take().job_id == first.id
    # A running job may have begun before the last change: another one must be queued.
    assert do(jobs.enqueue, "index", map_id=park, key="x").id not in {first.id, *others}


def test_who_is_slower_finds_the_job_of_who_was_quicker(library, do, park, monkeypatch):
    first = do(jobs.enqueue, "index", map_id=park)
    real, looks = jobs._waiting, []

    def blind_at_first(*arguments, **named):
        looks.append(1)
        return None if len(looks) == 1 else real(*arguments, **named)

    monkeypatch.setattr(jobs, "_waiting", blind_at_first)
    assert do(jobs.enqueue, "index", map_id=park).id == first.id


def test_the_oldest_comes_first_and_jobs_of_one_map_take_turns(do, take, park, new_map, new_account):
    lake = new_map(new_account("ben"), name="Lake")
    ids = [do(jobs.enqueue, kind, map_id=m).id for kind, m in (("a", park), ("b", park), ("a", lake))]
    first = take()
    assert first.job_id == ids[0]
    assert take().job_id == ids[2]
    assert take() is None
    assert do(jobs.finish, first)
    assert take().job_id == ids[1]


def test_short_work_overtakes_long_work_and_what_somebody_waits_for_the_background(
    do, take, new_map, new_account
):
    ana = new_account("ana")
    asked = {"map_id": new_map(ana, name="Lake"), "account_id": ana.id}
    background = do(jobs.enqueue, "index", map_id=new_map(ana, name="Park")).id
    index, export = do(jobs.enqueue, "index", **asked).id, do(jobs.enqueue, "export", **asked).id
    assert [take(lanes=LANES).job_id for _ in range(3)] == [export, index, background]


def test_a_worker_for_short_work_takes_nothing_else_even_of_a_dead_worker(do, take, at, park):
    index = do(jobs.enqueue, "index", map_id=park).id
    assert take(lanes=SHORT) is None
    assert take(lanes=LANES).job_id == index
    export = do(jobs.enqueue, "export", map_id=park).id
    tiles = do(jobs.enqueue, "tiles", map_id=park).id
    at(11)
    first = take("b", lanes=SHORT)
    assert first.job_id == export, "beside the index of the same map"
    assert take("c", lanes=SHORT) is None, "but one short job of a map at a time"
    do(jobs.finish, first)
    assert take("c", lanes=SHORT).job_id == tiles


def test_nothing_is_overtaken_for_ever(library, do, take, new_account):
    index = do(jobs.enqueue, "index").id
    do(jobs.enqueue, "export", account_id=new_account("ana").id)
    with library.database.write() as session:
        jobs.find(session, index).created_at -= timedelta(minutes=31)
    assert take(lanes=LANES).job_id == index


def test_a_job_in_the_background_makes_room_for_one_that_somebody_waits_for(do, take, at, new_account):
    do(jobs.enqueue, "index")
    held = take(lanes=LANES)
    at(5)
    do(jobs.enqueue, "index", key="background")
    assert not do(jobs.should_yield, held, lanes=LANES)
    asked = do(jobs.enqueue, "evaluate", account_id=new_account("ana").id).id
    at(-4)
    assert not do(jobs.should_yield, held, lanes=LANES), "another worker may be free"
    at(4)
    assert do(jobs.should_yield, held, lanes=LANES)
    do(jobs.requeue, held)
    first = take(lanes=LANES)
    assert first.job_id == asked
    assert not do(jobs.should_yield, first, lanes=LANES)


def test_a_job_makes_room_three_times(do, take, at, new_account):
    do(jobs.enqueue, "index")
    ana, yields = new_account("ana").id, []
    for n in range(5):
        held = take(lanes=LANES)
        asked = do(jobs.enqueue, "evaluate", key=str(n), account_id=ana).id
        at(5)
        yields.append(do(jobs.should_yield, held, lanes=LANES))
        do(jobs.requeue, held)
        first = take(lanes=LANES)
        assert first.job_id == asked
        do(jobs.finish, first)
    assert yields == [True, True, True, False, False]


def test_a_job_makes_room_ten_times_for_photos(do, take, at):
    do(jobs.enqueue, "index")
    yields = []
    for n in range(12):
        held = take(lanes=LANES)
        asked = do(jobs.enqueue, "index", key=str(n)).id
        ask(do, asked)
        at(5)
        yields.append(do(jobs.should_yield, held, lanes=LANES))
        do(jobs.requeue, held)
        first = take(lanes=LANES)
        assert first.job_id == asked
        do(jobs.finish, first)
    assert yields == [True] * 10 + [False] * 2


def test_what_a_photo_waits_for_comes_before_what_somebody_started(do, take, at, new_account):
    ana = new_account("ana").id
    started = do(jobs.enqueue, "evaluate", account_id=ana).id
    index = do(jobs.enqueue, "index", key="own").id
    export = do(jobs.enqueue, "export").id
    ask(do, index)
    taken = [take(lanes=LANES) for _ in range(3)]
    assert [held.job_id for held in taken] == [export, index, started]
    for held in taken:
        do(jobs.finish, held)
    forgotten, started = do(jobs.enqueue, "index").id, do(jobs.enqueue, "evaluate", account_id=ana).id
    ask(do, forgotten)
    at(301)
    asked = do(jobs.enqueue, "index", key="of another map").id
    ask(do, asked)
    assert [take(lanes=LANES).job_id for _ in range(3)] == [asked, forgotten, started]


def test_what_somebody_started_makes_room_for_what_a_photo_waits_for(do, take, at, park, new_account):
    """Also on the same map: an evaluation ends for the index that a photo waits for."""
    started = do(jobs.enqueue, "evaluate", map_id=park, account_id=new_account("eva").id).id
    held = take(lanes=LANES)
    index = do(jobs.enqueue, "index", map_id=park).id
    at(5)
    assert not do(jobs.should_yield, held, lanes=LANES)
    ask(do, index)
    assert take("b", lanes=LANES) is None
    assert do(jobs.should_yield, held, lanes=LANES)
    do(jobs.requeue, held)
    held = take(lanes=LANES)
    assert held.job_id == index
    ask(do, do(jobs.enqueue, "index", key="of another map").id)
    at(5)
    assert not do(jobs.should_yield, held, lanes=LANES), "a photo waits for this one, too"
    do(jobs.finish, held)
    assert [take(lanes=LANES).job_id for _ in range(2)][1] == started


def test_a_merged_job_is_as_urgent_as_the_more_urgent_one(do, new_account):
    assert not do(jobs.enqueue, "index").urgent
    assert do(jobs.enqueue, "index", account_id=new_account("ana").id).urgent


def test_each_job_is_given_to_one_of_many(library, do):
    ids = {do(jobs.enqueue, "x", key=str(n)).id for n in range(12)}
    taken = []

    def work(who):
        while True:
            with library.database.write() as session:
                job = jobs.lease(session, who, limits=LIMITS)
                if job is None:
                    return
                taken.append(job.id)

    threads = [threading.Thread(target=work, args=(str(n),)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(taken) == sorted(ids)


def test_a_lease_that_is_renewed_lasts(do, take, at):
    do(jobs.enqueue, "x")
    held = take()
    for _ in range(3):
        at(8)
        assert take("b") is None
        assert do(jobs.beat, held, seconds=10.0, progress=(1, 4, "so")).cancel_wanted is False
    at(11)
    assert take("b").fence == held.fence + 1


def test_a_clock_that_goes_back_neither_doubles_nor_loses_a_job(do, take, at):
    do(jobs.enqueue, "x")
    held = take("a")
    at(-3600)
    assert take("b") is None, "it is held until later than ever"
    assert do(jobs.beat, held, seconds=10.0, progress=(1, 2, "so"))
    at(11)
    second = take("b")
    assert second.fence == held.fence + 1, "from the first beat on, the new time counts"
    at(-3600)
    assert take("c", is_gone=lambda worker: worker == "b").fence == second.fence + 1, (
        "nobody waits for the dead"
    )


def test_nobody_waits_an_hour_for_a_clock_that_went_back(do, take, at):
    """A worker of another machine dies, and the clock is set back: its lease is as short as any."""
    do(jobs.enqueue, "x")
    held = take("a")
    at(-3600)
    assert take("b") is None
    at(LIMITS.seconds + 1)
    assert take("b").fence == held.fence + 1


def test_a_job_that_was_put_off_does_not_wait_an_hour_longer(do, take, at):
    do(jobs.enqueue, "x")
    do(jobs.postpone, take(), **AWAY)
    at(-3600)
    assert do(jobs.anything_to_do)
    assert take().fence == 2


def test_jobs_keep_their_order_when_the_clock_goes_back(do, take, at, library):
    """What is queued in the hour after does not overtake what was queued before."""
    begun = clock.now()
    written = {"a": 0, "b": 1, "c": -3600, "d": -3599}
    ids = {key: do(jobs.enqueue, "x", key=key).id for key in written}
    with library.database.write() as session:
        for key, seconds in written.items():
            session.get(Job, ids[key]).created_at = begun + timedelta(seconds=seconds)
    at(-3590)
    assert [take(f"{n}").job_id for n in range(4)] == list(ids.values())


def test_who_lost_the_lease_writes_nothing(do, take, at, seen):
    id = do(jobs.enqueue, "x").id
    old = take("a")
    at(11)
    new = take("b")
    assert do(jobs.beat, new, seconds=10.0, progress=(1, 3, "mine"))
    assert do(jobs.beat, old, seconds=10.0, progress=(2, 3, "theirs")) is None
    assert not do(jobs.finish, old)
    assert not do(jobs.fail, old, error=ERROR)
    assert not do(jobs.stop, old)
    assert not do(jobs.requeue, old)
    with pytest.raises(Conflict, match="taken over this job"):
        do(jobs.guard, old)
    do(jobs.guard, new)
    assert (seen(id)["state"], seen(id)["done"], seen(id)["note"]) == ("running", 1, "mine")
    assert do(jobs.finish, new, result={"n": 1})
    assert not do(jobs.finish, new)
    assert (seen(id)["state"], seen(id)["result"]) == ("done", {"n": 1})


def test_the_lease_of_a_dead_worker_ends_at_once(do, take):
    do(jobs.enqueue, "x")
    take("a")
    assert take("b", is_gone=lambda who: who != "a") is None
    assert take("b", is_gone=lambda who: who == "a").fence == 2


def test_a_job_on_which_workers_die_fails(do, take, at, seen):
    id = do(jobs.enqueue, "x").id
    for fence in (1, 2, 3):
        held = take()
        assert held.fence == fence
        do(jobs.beat, held, seconds=10.0, progress=(0, 0, ""))
        at(11)
    other = do(jobs.enqueue, "y").id
    assert take().job_id == other
    job = seen(id)
    assert (job["state"], job["error"]["message"]) == ("failed", "the worker died 3 times on this job")
    assert job["done"] < job["total"]


def test_a_job_that_gets_on_between_deaths_continues_but_not_for_ever(do, take, at, seen):
    id = do(jobs.enqueue, "x").id
    for fence in range(1, 31):
        held = take()
        assert held.fence == fence
        do(jobs.beat, held, seconds=10.0, progress=(5, 5, ""))
        at(11)
    assert take() is None
    job = seen(id)
    assert (job["state"], job["error"]["message"]) == ("failed", "the worker died 30 times on this job")
    assert job["done"] < job["total"]


def test_being_given_back_is_no_death(do, take, seen):
    id = do(jobs.enqueue, "x").id
    for _ in range(5):
        held = take()
        assert held.job_id == id
        assert do(jobs.requeue, held)
        assert seen(id)["state"] == "queued"


AWAY = {"note": "the object storage cannot be reached", "pause_s": 10.0}


def test_a_job_for_which_something_is_away_lets_others_go_first(do, take, at, seen):
    first, second = (do(jobs.enqueue, "x", key=str(n)).id for n in range(2))
    held = take()
    assert held.job_id == first
    assert do(jobs.postpone, held, **AWAY)
    assert (seen(first)["state"], seen(first)["note"]) == ("queued", AWAY["note"])
    assert (seen(first)["next_try_s"], seen(second)["next_try_s"]) == (10.0, None)
    at(4)
    assert seen(first)["next_try_s"] == 6.0
    other = take()
    assert other.job_id == second
    assert take() is None, "its pause is not over"
    assert do(jobs.finish, other)
    assert not do(jobs.anything_to_do) and do(jobs.anything_to_do, early=True)
    at(6)
    assert do(jobs.anything_to_do)
    third = do(jobs.enqueue, "x", key="2").id
    again = take()
    assert again.job_id == first
    assert do(jobs.requeue, again)  # its worker is being stopped
    assert [take().job_id, take().job_id] == [first, third]


def test_the_pause_doubles_up_to_five_minutes(do, take, at):
    do(jobs.enqueue, "x")
    for pause in (10, 20, 40, 80, 160, 300, 300):
        held = take()
        do(jobs.postpone, held, **AWAY)
        at(pause - 0.1)
        assert take() is None
        at(0.1)
    last = take()
    assert last.fence == 8
    assert do(jobs.fail, last, error=ERROR)
    do(lambda s: jobs.retry(s, jobs.find(s, last.job_id)))
    assert do(jobs.postpone, take(), **AWAY)
    at(10)
    assert take() is not None, "who asks for another try begins with the first pause"


def test_who_cannot_wait_takes_a_job_in_its_pause(do, take):
    do(jobs.enqueue, "x")
    do(jobs.postpone, take(), **AWAY)
    assert take() is None
    assert take(early=True).fence == 2


def test_a_lease_taken_by_the_version_before_ends_as_any(do, take, at):
    """The earlier version does not know pauses, and leaves them in the jobs that it takes."""
    id = do(jobs.enqueue, "x").id
    do(jobs.postpone, take(), note="away", pause_s=200.0)
    held = take(early=True)
    do(lambda s: setattr(jobs.find(s, id), "not_before", jobs.moment(s) + timedelta(seconds=200)))
    at(11)
    assert do(jobs.anything_to_do)
    assert take().fence == held.fence + 1


def test_what_the_version_before_queues_has_no_pause(library, do, take):
    columns = "kind, key, arguments, state, done, total, note, attempts, cancel_wanted, fence, created_at"
    values = "'x', '', '{}', 'queued', 0, 0, '', 0, false, 0, CURRENT_TIMESTAMP"
    do(lambda s: s.connection().exec_driver_sql(f"INSERT INTO job ({columns}) VALUES ({values})"))
    assert do(jobs.postpone, take(), **AWAY)


def test_the_one_that_waits_already_takes_the_pause_over(do, take, at, park, seen):
    first = do(jobs.enqueue, "index", map_id=park).id
    held = take()
    second = do(jobs.enqueue, "index", map_id=park).id
    assert do(jobs.postpone, held, **AWAY)
    assert (seen(first)["state"], seen(second)["state"]) == ("cancelled", "queued")
    assert take() is None and seen(second)["note"] == AWAY["note"]
    at(10)
    held = take()
    do(jobs.postpone, held, **AWAY)
    at(19)
    assert take() is None
    at(1)
    assert take().job_id == second


def test_given_back_while_one_like_it_waits_leaves_one(do, take, park, seen):
    first = do(jobs.enqueue, "index", map_id=park).id
    held = take()
    second = do(jobs.enqueue, "index", map_id=park).id
    assert do(jobs.requeue, held)
    assert (seen(first)["state"], seen(second)["state"]) == ("cancelled", "queued")


def test_cancel(do, take, at, seen):
    waiting, running, orphan = (do(jobs.enqueue, "x", key=str(n)).id for n in range(3))
    do(lambda s: jobs.cancel(s, jobs.find(s, waiting)))
    assert seen(waiting)["state"] == "cancelled"
    held, lost = take(), take("b")
    assert (held.job_id, lost.job_id) == (running, orphan)
    for id in (running, orphan):
        do(lambda s, id=id: jobs.cancel(s, jobs.find(s, id)))
    assert do(jobs.beat, held, seconds=100.0, progress=(2, 2, "")).cancel_wanted
    assert do(jobs.stop, held)
    assert (seen(running)["state"], seen(running)["done"]) == ("cancelled", 1)
    at(11)
    assert take() is None
    assert seen(orphan)["state"] == "cancelled"
    do(lambda s: jobs.cancel(s, jobs.find(s, running)))
    assert seen(running)["state"] == "cancelled"


@pytest.mark.parametrize("progress", [(0, 0), (3, 3), (9, 3), (1, 3)])
def test_only_a_job_that_is_done_is_at_its_end(do, take, progress, seen):
    failed, done = do(jobs.enqueue, "x", key="1").id, do(jobs.enqueue, "x", key="2").id
    for end in (lambda held: do(jobs.fail, held, error=ERROR), lambda held: do(jobs.finish, held)):
        held = take()
        do(jobs.beat, held, seconds=10.0, progress=(*progress, ""))
        assert end(held)
    assert seen(failed)["done"] < seen(failed)["total"]
    assert seen(failed)["error"] == ERROR
    assert seen(done)["done"] == seen(done)["total"] > 0


def test_retry(do, take, seen):
    id = do(jobs.enqueue, "x").id
    retry = lambda: do(lambda s: jobs.retry(s, jobs.find(s, id)).id)  # noqa: E731
    with pytest.raises(Conflict, match="is queued"):
        retry()
    assert do(jobs.fail, take(), error=ERROR)
    assert retry() == id
    assert (seen(id)["state"], seen(id)["error"], seen(id)["done"]) == ("queued", None, 0)
    held = take()
    assert held.fence == 2
    twin = do(jobs.enqueue, "x").id
    assert do(jobs.stop, held)
    assert retry() == twin
    with pytest.raises(NotFound):
        do(lambda s: jobs.find(s, 99))


def test_what_a_page_shows(do, take, at, park):
    old, new = do(jobs.enqueue, "a", map_id=park).id, do(jobs.enqueue, "b", map_id=park).id
    do(jobs.enqueue, "c")
    ids = lambda: do(lambda s: [job.id for job in job_views.current(s, park)])  # noqa: E731
    assert ids() == [old, new]
    assert do(jobs.finish, take())
    assert ids() == [old, new]
    at(61)
    assert ids() == [new]
    assert do(lambda s: [job.id for job in jobs.list_jobs(s, map_id=park)]) == [new, old]
    assert do(lambda s: len(jobs.list_jobs(s))) == 3
    assert do(jobs.anything_to_do)


def test_a_failure_is_shown_until_the_job_is_repeated_for_a_week_at_most(do, take, at, park):
    ids = lambda: do(lambda s: [job.id for job in job_views.shown(s, park)])  # noqa: E731
    failed = do(jobs.enqueue, "a", map_id=park).id
    do(jobs.fail, take(), error=ERROR)
    at(3600)
    assert ids() == [failed]
    other = do(jobs.enqueue, "b", map_id=park).id
    assert ids() == [failed, other]
    again = do(jobs.enqueue, "a", map_id=park).id
    assert ids() == [other, again]
    do(jobs.finish, take())
    do(jobs.fail, take(), error=ERROR)
    at(3600)
    assert ids() == [again]
    at(7 * 86400)
    assert ids() == []


def test_a_failure_about_the_image_is_over_once_the_map_got_another(do, take, at, park):
    ids = lambda: do(lambda s: [job.id for job in job_views.shown(s, park)])  # noqa: E731
    for kind in (job_views.TILES_JOB, job_views.PYRAMID_JOB, "index"):
        do(jobs.enqueue, kind, map_id=park)
        do(jobs.fail, take(), error=ERROR)
    *about_image, index = ids()
    at(2)
    assert ids() == [*about_image, index]
    image = {"map_id": park, "kind": "satellite", "changes": [], "revision": 1, "at": clock.now()}
    do(lambda s: s.add(Edit(**image)))
    assert ids() == [index], "at once"
    do(jobs.enqueue, job_views.TILES_JOB, map_id=park)
    do(jobs.fail, take(), error=ERROR)
    assert len(ids()) == 2


def test_a_fetch_that_fails_after_another_image_was_chosen_is_not_shown(do, take, at, park, library):
    do(jobs.enqueue, job_views.TILES_JOB, map_id=park)
    held = take()
    at(3600)
    chosen = clock.now() + timedelta(seconds=60)
    do(lambda s: s.add(Edit(map_id=park, kind="satellite", changes=[], revision=1, at=chosen)))
    do(jobs.fail, held, error=ERROR)
    assert do(lambda s: job_views.shown(s, park)) == []


def test_a_failure_is_over_once_another_job_of_its_kind_succeeds(do, take, at, park):
    ids = lambda: do(lambda s: [job.id for job in job_views.shown(s, park)])  # noqa: E731
    failed = do(jobs.enqueue, "index", map_id=park, key="xfeat").id
    do(jobs.fail, take(), error=ERROR)
    at(1)
    later = do(jobs.enqueue, "index", map_id=park).id
    assert ids() == [failed, later]
    at(1)
    do(jobs.finish, take())
    assert ids() == [later]


def test_time_left():
    start = clock.now()
    job = Job(state="running", started_at=start, done=0, total=10)
    after = lambda seconds: job_views.seconds_left(job, at=start + timedelta(seconds=seconds))  # noqa: E731
    assert after(5) is None
    job.done = 4
    assert after(8) == pytest.approx(12.0)
    job.done = 10
    assert after(8) == 0.0
    job.state = "done"
    assert after(8) is None


def test_the_object_for_pages(do, take, park, seen):
    id = do(jobs.enqueue, "index", map_id=park).id
    names = "id kind map state done total note error result created_at seconds seconds_left next_try_s mine"
    assert seen(id).keys() == set(names.split())
    assert (seen(id)["map"], seen(id)["state"], seen(id)["seconds_left"]) == ("park", "queued", None)


def test_the_id_of_a_job_of_a_deleted_map_is_not_used_again(library, do, new_account, new_map):
    owner = new_account("owner")
    map_id = new_map(owner)
    first = do(jobs.enqueue, "index", map_id=map_id).id
    with library.database.write() as session:
        session.delete(session.get_one(MapRecord, map_id))
    with pytest.raises(NotFound):
        do(jobs.find, first)
    assert do(jobs.enqueue, "index", map_id=new_map(owner, name="Other")).id > first


def test_jobs_that_have_ended_are_not_read_again_and_again(library, sqlite_only):
    """Idle workers and pages poll every second, while ended jobs are kept."""
    asked = []

    def note(_connection, _cursor, statement, parameters, *_):
        asked.append((statement, parameters))

    sqlalchemy.event.listen(library.database.engine, "before_cursor_execute", note)
    with library.database.read() as session:
        jobs.anything_to_do(session)
        job_views.current(session, 1)
        job_views.recent(session, map_ids=select(MapRecord.id), account=Account(id=1, is_owner=True))
        plans = [
            session.connection().exec_driver_sql(f"EXPLAIN QUERY PLAN {s}", p).all() for s, p in [*asked]
        ]
    steps = [step for plan in plans for *_, step in plan]
    assert sum("INDEX ix_job_ended_at (ended_at>?)" in step for step in steps) == 2
    assert not [step for step in steps if step.startswith("SCAN job")]
