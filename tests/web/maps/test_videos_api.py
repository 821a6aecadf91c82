"""Videos through the API: uploaded in chunks, cut by a job that continues after a kill; swept if left."""

import os
import time
from contextlib import contextmanager

import pytest

from tests.tasks.video.test_cut_video import GPX, POSITIONS, STARTS
from tests.video_clips import pan, write_clip
from webapp import extras
from webapp.errors import Cancelled, PhotoError
from webapp.jobs.context import Context, JobProgress
from webapp.jobs.map_jobs import cut_map_video
from webapp.settings import Settings, UploadLimits
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.tasks.video import add_video
from webapp.web.chunks import HEADER

LIMITS = jobs.Limits(seconds=60, attempts=3)


@pytest.fixture(autouse=True)
def needs_av():
    pytest.importorskip("av", reason="PyAV (the extra `video`) is not installed")


@pytest.fixture
def settings(tmp_path):
    return Settings(library=tmp_path / "library", upload=UploadLimits(video_mb=1.0))


@pytest.fixture
def base(park):
    return f"/api/v1/maps/{park}"


@pytest.fixture
def clip(tmp_path):
    return write_clip(tmp_path / "A walk.mp4", pan(POSITIONS), metadata=STARTS).read_bytes()


def send(client, base, name, data, *, chunk=40_000, most=None):
    """Upload a file, or its first chunks; return the id of the upload."""
    about = {"name": name, "size_bytes": len(data), "fingerprint": name}
    begun = client.post(f"{base}/uploads", json=about)
    assert begun.status_code == 201, begun.json
    id, offset = begun.json["id"], begun.json["offset"]
    while offset < len(data) and most != 0:
        part = data[offset : offset + chunk]
        answer = client.patch(f"{base}/uploads/{id}", data=part, headers={HEADER: str(offset)})
        assert set(answer.json) == {"offset"}
        offset = answer.json["offset"]
        most = None if most is None else most - 1
    return id


def run(library, settings, progress=None):
    """Run the queued job as the worker does; return its result."""
    with library.database.write() as session:
        while (job := jobs.lease(session, "test", limits=LIMITS)).kind != add_video.JOB:
            jobs.finish(session, jobs.Lease(job.id, job.fence))
        held, arguments = jobs.Lease(job.id, job.fence), dict(job.arguments)
        ids = job.map_id, job.account_id
    context = Context(library, settings, progress or JobProgress(), held, *ids, arguments)
    return cut_map_video(context), held


def photos(client, base):
    return client.get(base).json["photos"]


def test_a_video_with_a_track_becomes_photos_with_time_and_position(client, base, library, settings, clip):
    assert client.get(f"{base}/videos").json == {"available": True, "install": None, "most_mb": 1.0}
    wish = {
        "clip": send(client, base, "A walk.mp4", clip),
        "track": send(client, base, "walk.gpx", GPX.encode()),
        "fov_deg": 70.0,
    }
    answer = client.post(f"{base}/videos", json=wish)
    assert (answer.status_code, answer.json["kind"]) == (202, "video-photos")
    assert not [*library.uploads.glob("*.part")]
    result, _ = run(library, settings)
    assert result["added"] == result["photos"] == result["with_position"] > 6
    assert (result["failed"], result["duplicates"]) == ([], 0)
    found = photos(client, base)
    assert len(found) == result["added"]
    assert found[0]["name"].startswith("A_walk_0000")
    assert found[0]["taken_at"].startswith("2026-05-01T10:00:0")
    assert found[0]["fov_deg"] == pytest.approx(70.0, abs=1.5)
    assert not [*(library.inner / "videos").iterdir()]


def test_an_upload_is_resumed(client, base, clip):
    first = send(client, base, "A walk.mp4", clip, most=1)
    refused = client.post(f"{base}/videos", json={"clip": first})
    assert refused.status_code == 400
    assert f"40000 of {len(clip)} bytes have arrived" in refused.json["error"]["message"]
    assert send(client, base, "A walk.mp4", clip) == first


class Killed(JobProgress):
    """Stops the job after some photos of the second stage were added."""

    def __init__(self, photos):
        super().__init__()
        self.left = photos
        self.adding = False

    def note(self, text):
        self.adding = text == "adding the photos"

    def check(self):
        self.left -= self.adding
        if self.left < 0:
            raise Cancelled("killed")


@pytest.mark.parametrize("after", [0, 3])
def test_a_job_that_is_killed_is_continued(client, base, library, settings, clip, after):
    client.post(f"{base}/videos", json={"clip": send(client, base, "A walk.mp4", clip)})
    with library.database.write() as session:
        job = session.query(Job).filter_by(kind="video-photos").one().id
    with pytest.raises(Cancelled):
        run(library, settings, Killed(after))
    before = len(photos(client, base))
    assert before == after
    with library.database.write() as session:
        jobs.cancel(session, session.get_one(Job, job))
        session.get_one(Job, job).state = "cancelled"
        jobs.retry(session, session.get_one(Job, job))
    result, _ = run(library, settings)
    assert (result["added"], result["duplicates"]) == (result["photos"] - after, after)
    assert len({photo["name"] for photo in photos(client, base)}) == result["photos"]


def test_a_photo_whose_record_was_not_committed_is_added_by_the_next_run(
    client, base, library, settings, clip, monkeypatch
):
    client.post(f"{base}/videos", json={"clip": send(client, base, "A walk.mp4", clip)})
    commit = library.changing

    @contextmanager
    def ends_before_it_commits(map_id, **more):
        with commit(map_id, **more) as change:
            yield change
            raise Cancelled("killed")

    with monkeypatch.context() as patched:
        patched.setattr(Context, "changing", staticmethod(ends_before_it_commits))
        with pytest.raises(Cancelled):
            run(library, settings)
    assert photos(client, base) == []
    with library.database.write() as session:
        job = session.query(Job).filter_by(kind="video-photos").one()
        job.state = "cancelled"
        jobs.retry(session, job)
    result, _ = run(library, settings)
    assert (result["added"], result["duplicates"]) == (result["photos"], 0)
    assert len(photos(client, base)) == result["photos"]
    assert not [*(library.inner / "videos").iterdir()]


def test_what_is_no_video_or_too_large_is_refused(client, base, settings, monkeypatch):
    large = {"name": "a.mp4", "size_bytes": 1_000_001, "fingerprint": "a"}
    refused = client.post(f"{base}/uploads", json=large)
    assert refused.status_code == 422
    assert refused.json["error"]["message"] == "it has 1 MB, more than the limit of 1"
    assert refused.json["error"]["hint"] == "cut it on your computer: expmap map cut-video"
    gpx = send(client, base, "walk.gpx", GPX.encode())
    assert client.post(f"{base}/videos", json={"clip": gpx}).json["error"]["message"] == "it is not a video"
    for starts in ("noon", "9999-12-31T23:59:59Z"):
        wish = {"clip": gpx, "starts": starts}
        assert client.post(f"{base}/videos", json=wish).json["error"]["message"] == "this is not a time"
    assert client.post(f"{base}/videos", json={"clip": "0" * 32}).status_code == 404


def test_a_damaged_video_says_so(client, base, library, settings):
    clip = send(client, base, "a.mov", bytes(range(200)))
    client.post(f"{base}/videos", json={"clip": clip})
    with pytest.raises(PhotoError):
        run(library, settings)


def test_a_server_without_the_extra_says_what_to_install(client, base, monkeypatch):
    monkeypatch.setattr(extras, "EXTRAS", {**extras.EXTRAS, "video": ("no_such_package",)})
    here = client.get(f"{base}/videos").json
    assert (here["available"], here["install"]) == (False, "pip install 'experience-map[video]'")
    about = {"name": "a.mp4", "size_bytes": 10, "fingerprint": "a"}
    refused = client.post(f"{base}/uploads", json=about)
    assert refused.status_code == 422
    assert "needed for photos from videos" in refused.json["error"]["message"]


def test_an_abandoned_video_is_swept_but_not_one_whose_job_waits(client, base, library, settings, clip):
    client.post(f"{base}/videos", json={"clip": send(client, base, "A walk.mp4", clip)})
    (waiting,) = (library.inner / "videos").iterdir()
    left = add_video.waiting_folder(library, "ab")
    left.mkdir()
    long_ago = time.time() - 3600.0 * 100.0
    for folder in (waiting, left):
        os.utime(folder, (long_ago, long_ago))
    add_video.sweep(library, settings)
    assert [*(library.inner / "videos").iterdir()] == [waiting]


def test_viewers_cannot(client, base, clip, sign_in, new_account):
    upload = send(client, base, "A walk.mp4", clip)
    stranger = sign_in(new_account("vera"))
    assert stranger.post(f"{base}/videos", json={"clip": upload}).status_code in (403, 404)
