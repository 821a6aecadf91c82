"""Which photos can be joined: checked by a job, and shown without photos that were removed since."""

from webapp.jobs.kinds import KINDS
from webapp.store.schema import Job
from webapp.tasks.landmarks import photo_pieces
from webapp.tasks.landmarks.photo_pieces import PhotoGap, PiecesReport

REPORT = PiecesReport(
    revision=3,
    names={n: f"photos/{n}.jpg" for n in range(4)},
    pieces=((0, 1, 99),),
    alone=(2, 3),
    bridges=(1,),
    gaps=(PhotoGap(2, 1, 13), PhotoGap(3, 99, 0)),
    place_next=(0, 99),
    failed={},
)


def test_nothing_is_known_before_somebody_asks(client, yard):
    found = client.get(f"{yard[0]}/pieces").json
    assert (found["revision"], found["pieces"], found["job"]) == (None, [], None)


def test_the_latest_check_is_shown_without_removed_photos(client, yard, library):
    url, slug = yard
    photo_pieces.keep(library.cfg(slug), REPORT)
    found = client.get(f"{url}/pieces").json
    assert (found["pieces"], found["alone"], found["bridges"]) == ([[0, 1]], [2, 3], [1])
    assert found["gaps"] == [{"photo": 2, "other": 1, "matches": 13}]
    assert found["place_next"] == [0]


def test_checking_is_a_job_that_does_not_wait_behind_long_ones(client, yard, library):
    answer = client.post(f"{yard[0]}/pieces", json={})
    assert answer.status_code == 202
    with library.database.read() as session:
        job = session.get(Job, answer.json["job"])
    assert KINDS[job.kind].short
    assert job.kind == "photo-pieces"


def test_a_damaged_report_is_reported(client, yard, library):
    url, slug = yard
    photo_pieces.keep(library.cfg(slug), REPORT)
    (library.map_folder(slug) / "derived" / photo_pieces.STORED).write_text("{", encoding="utf-8")
    answer = client.get(f"{url}/pieces")
    assert answer.status_code >= 400
    assert "check the photos again" in answer.text
