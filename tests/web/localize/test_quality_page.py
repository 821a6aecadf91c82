"""The page Quality: how well photos are found on a map."""

import json
from dataclasses import replace

import pytest
from sqlalchemy import select

from webapp.core.geo.fit import Corners, from_corners
from webapp.core.geo.types import LatLon
from webapp.core.hypotheses.calibration import DEFAULT
from webapp.files.localize import calibration
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.maps.map_json import georeference_fields
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo, QueryRecord
from webapp.tasks.evaluation import stored as stored_evaluation
from webapp.tasks.maps import adopt_map

FIGURES = {
    "map_photos": 2,
    "map_revision": 0,
    "queries": 2,
    "abstained": 1,
    "place_radius_px": 50.0,
    "median_px": 12.0,
    **{f"within_{radius}px": 0.5 for radius in (10, 20, 50, 100, 400)},
    "answered_at_99_precision": 0.25,
    "intervals_95": {"within_50px": [0.125, 0.75]},
}
FOUND = {"path": "photos/0.jpg", "error_px": 12.0, "answer": {"hypotheses": [{"probability": 0.75}]}}
LOST = {"path": "photos/1.jpg", "error_px": None, "answer": {"query": "x", "error": "no photo"}}


@pytest.fixture
def evaluated(library, owner, make_map):
    """The slug of a map with an evaluation of both schemes."""
    cfg = make_map(library.map_folder("row"), 2)
    adopt_map.adopt_map(library, "row", account_id=owner.id)
    schemes = [{"scheme": "leave-one-out"}, {"scheme": "leave-one-place-out", "hide_within_px": 50.0}]
    (cfg.parent / "derived").mkdir(exist_ok=True)
    forms = [{**FIGURES, **scheme, "per_query": [FOUND, LOST]} for scheme in schemes]
    (cfg.parent / "derived" / stored_evaluation.FILE).write_text(json.dumps(forms))
    return "row"


def test_the_figures_and_the_charts_are_shown(client, evaluated):
    text = client.get(f"/maps/{evaluated}/quality").text
    assert text.count('data-testid="quality"') == 2
    assert text.count('<svg class="chart"') == 4
    assert "12 px" in text and "25%" in text and "12% – 75%" in text
    assert "1 photos: 75% stated, 100% correct" in text
    assert "Likely range" in text and "with 19 in 20 chances within the likely range" in text
    assert 'id="evaluate"' in text
    assert "The map has changed since" not in text


def test_photos_that_were_not_found_lead_to_the_editor(client, evaluated):
    text = client.get(f"/maps/{evaluated}/quality").text
    assert text.count("1 photo was not found") == 2
    assert text.count(f'href="/maps/{evaluated}/edit?photo=1"') == 2
    assert "no place found" in text and "?photo=0" not in text
    assert text.count("Add a photo here.") == 2
    assert f'href="/maps/{evaluated}/edit#next-photos"' in text


def test_a_sure_answer_elsewhere_says_what_to_check(client, library, evaluated):
    path = library.map_folder("row") / "derived" / stored_evaluation.FILE
    forms = json.loads(path.read_text())
    for form in forms:
        form["per_query"] = [{**FOUND, "error_px": 400.0}]
    path.write_text(json.dumps(forms))
    text = client.get(f"/maps/{evaluated}/quality").text
    assert "400 px off, though the answer gave its place 75%" in text
    assert "Check its place; other places look similar." in text and "Add a photo here." not in text


def test_distances_are_in_metres_first(client, library, evaluated):
    with library.database.write() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == evaluated)).one()
        size = (record.satellite_width, record.satellite_height)
        wide = size[0] * 0.1 / 111_319.5  # ten pixels a metre at the equator
        high = size[1] * 0.1 / 110_574.3
        fit = from_corners(Corners(LatLon(high, 0), LatLon(0, wide)), width=size[0], height=size[1])
        record.georeference = georeference_fields(fit.georeference)
    text = client.get(f"/maps/{evaluated}/quality").text
    assert "1 of 2 photos are found to within 5.0\xa0m (50 px)." in text
    assert "Half of the answers are at most 1.2\xa0m (12 px) off." in text


def test_an_edit_makes_it_old(client, evaluated):
    place = {"kind": "move", "changes": [{"id": 0, "x_px": 5.0, "y_px": 5.0}]}
    assert client.patch(f"/api/v1/maps/{evaluated}/experiences", json=place).status_code == 200
    assert "The map has changed since" in client.get(f"/maps/{evaluated}/quality").text


def test_before_the_first_and_while_one_is_going(client, library, owner, make_map):
    make_map(library.map_folder("row"), 2)
    adopt_map.adopt_map(library, "row", account_id=owner.id)
    page = client.get("/maps/row/quality").text
    assert "Not evaluated yet" in page
    assert "#check" not in page.split('class="empty"')[1]  # a tick would look like success
    job = client.post("/api/v1/maps/row/evaluation", json={}).json["id"]
    page = client.get("/maps/row/quality").text
    assert f'"job": {job}' in page or f'"job":{job}' in page


def test_a_map_without_places_has_nothing_to_try(client, park):
    page = client.get(f"/maps/{park}/quality").text
    assert "This map cannot localize photos yet" in page
    assert 'id="evaluate"' not in page


def test_viewers_look_and_others_see_nothing(client, sign_in, new_account, evaluated):
    viewer = new_account("Vera")
    assert sign_in(viewer).get(f"/maps/{evaluated}/quality").status_code == 404
    share = {"name": "Vera", "role": "viewer"}
    assert client.post(f"/api/v1/maps/{evaluated}/members", json=share).status_code == 200
    page = sign_in(viewer).get(f"/maps/{evaluated}/quality").text
    assert 'data-testid="quality"' in page and 'id="evaluate"' not in page


@pytest.mark.parametrize("text", ["{", "[{}]", "7"])
def test_a_damaged_file_is_reported(client, library, evaluated, text):
    (library.map_folder(evaluated) / "derived" / stored_evaluation.FILE).write_text(text)
    answer = client.get(f"/maps/{evaluated}/quality")
    assert answer.status_code == 200
    assert 'data-testid="error-message"' in answer.text and 'id="evaluate"' in answer.text


def test_what_was_kept_is_what_was_measured(library, evaluated):
    first, second = stored_evaluation.read(library.cfg(evaluated))
    assert (first.figures["scheme"], second.figures["hide_within_px"]) == ("leave-one-out", 50.0)
    assert first.errors.tolist() == [12.0, float("inf")]
    (bin,) = first.reliability
    assert (bin.probability, bin.right, bin.count) == (0.75, 1.0, 1)


def test_the_photos_that_fail_come_before_the_details(client, evaluated):
    page = client.get(f"/maps/{evaluated}/quality").text
    first = page[page.index('data-testid="quality"') :]
    assert first.index("quality__summary") < first.index("<details") < first.index("quality__table")
    if 'data-testid="misses"' in first:
        assert first.index('data-testid="misses"') < first.index("<details")


def test_the_time_of_an_answer_is_that_of_the_last_ones(client, evaluated, library):
    says = lambda: "Answers on this map take about" in client.get(f"/maps/{evaluated}/localize").text  # noqa: E731
    assert not says(), "none yet, and so no promise"
    with library.database.write() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == evaluated)).one()
        for total in (3.0, 4.2, 60.0):
            session.add(
                QueryRecord(
                    map_id=record.id,
                    name="a.jpg",
                    file=f"{total}.jpg",
                    width=4,
                    height=3,
                    options={},
                    answer={"seconds": {"total": total}},
                    evidence=[],
                )
            )
    assert "Answers on this map take about 4 seconds." in client.get(f"/maps/{evaluated}/localize").text


def test_photos_that_only_wait_and_notes_change_no_answer(client, evaluated, library):
    """A photo that is added to the tray, and a note, are no reason to evaluate again; a placed one is."""

    def changed():
        return "The map has changed since" in client.get(f"/maps/{evaluated}/quality").text

    for name in ("a", "b"):
        with library.changing(1) as change:
            row = Photo(name=f"{name}.jpg", path=f"{name}.jpg", sha256=name, size_bytes=1, width=2, height=2)
            maps.add_photo(change.session, change.record, row=row)
    note = {"kind": "note", "changes": [{"id": 0, "note": "By the gate."}]}
    assert client.patch(f"/api/v1/maps/{evaluated}/experiences", json=note).status_code == 200
    assert not changed()
    move = {"kind": "move", "changes": [{"id": 0, "x_px": 7, "y_px": 9}]}
    assert client.patch(f"/api/v1/maps/{evaluated}/experiences", json=move).status_code == 200
    assert changed()


@pytest.mark.parametrize(
    ("real", "says"), [(0, "on its own photos only"), (1, "on 1 real photo."), (34, "on 34 real photos.")]
)
def test_what_it_is_calibrated_on(client, library, evaluated, real, says):
    assert "is calibrated on" not in client.get(f"/maps/{evaluated}/quality").text
    fitted = replace(DEFAULT, cases=120 + real)
    there = library.map_folder(evaluated) / "derived" / "map" / "index" / "calibration-verified-ivf.json"
    calibration.write(there, StoredCalibration(fitted, None, 50.0, frozenset(), 1.0, queries=real))
    text = client.get(f"/maps/{evaluated}/quality").text
    assert f"How sure answers may be is calibrated {says}" in text
