"""Places for the photos in the tray: shown, accepted as one step, and computed by a job."""

import pytest

from tests.web.landmarks.conftest import place
from webapp.core.geo.types import MapPixel
from webapp.extras import install_line
from webapp.files.maps.map_json import parse_georeference
from webapp.jobs.kinds import KINDS
from webapp.store.schema import Job, MapRecord, Photo
from webapp.tasks.landmarks import stored
from webapp.tasks.landmarks.place_rest import (
    CheckedPhoto,
    CorrectedPlace,
    LeftPhoto,
    RestReport,
    SuggestedPlace,
)


@pytest.fixture
def suggested(yard, library):
    """The same, with suggestions for two of the photos."""
    url, slug = yard
    report = RestReport(
        (
            SuggestedPlace(1, "photos/1.jpg", MapPixel(100.0, 50.0), 5.0, 90.0, (0,)),
            SuggestedPlace(2, "photos/2.jpg", MapPixel(200.0, 60.0), 7.0, None, (0,)),
        ),
        (LeftPhoto(3, "photos/3.jpg", "too few photos overlap enough"),),
        (CheckedPhoto(0, "photos/0.jpg", 120.0, True),),
        (3,),
    )
    folder = library.map_folder(slug) / "derived"
    folder.mkdir(exist_ok=True)
    stored.keep(library.cfg(slug), report, revision=3)
    return url


def test_nothing_is_suggested_before_somebody_asks(client, yard):
    rest = client.get(f"{yard[0]}/place-rest").json
    assert rest["revision"] is None
    assert (rest["suggested"], rest["left"], rest["job"]) == ([], [], None)


def test_suggestions_are_shown_for_the_photos_in_the_tray(client, suggested):
    rest = client.get(f"{suggested}/place-rest").json
    assert [(p["id"], p["name"], p["x_px"], p["radius_px"]) for p in rest["suggested"]] == [
        (1, "1.jpg", 100.0, 5.0),
        (2, "2.jpg", 200.0, 7.0),
    ]
    assert [(p["name"], p["reason"]) for p in rest["left"]] == [("3.jpg", "too few photos overlap enough")]
    assert [(p["name"], p["residual_px"]) for p in rest["doubtful"]] == [("0.jpg", 120.0)]
    assert rest["place_next"] == [3]


def test_suggestions_are_accepted_in_one_step(client, suggested):
    answer = client.post(f"{suggested}/place-rest/accept", json={"ids": [1, 2]})
    assert answer.json["placed"] == [1, 2]
    assert answer.json["job"] is not None
    photos = {p["id"]: p for p in client.get(suggested).json["photos"]}
    assert (photos[1]["x_px"], photos[1]["y_px"], photos[1]["heading_deg"]) == (100.0, 50.0, 90.0)
    assert client.get(f"{suggested}/place-rest").json["suggested"] == []
    client.post(f"{suggested}/undo", json={})
    photos = {p["id"]: p for p in client.get(suggested).json["photos"]}
    assert photos[1]["x_px"] is None
    assert photos[2]["x_px"] is None
    assert len(client.get(f"{suggested}/place-rest").json["suggested"]) == 2


def test_an_accepted_place_is_as_exact_as_suggested_until_somebody_moves_the_photo(client, suggested):
    def radius():
        return {p["id"]: p for p in client.get(suggested).json["photos"]}[2]["radius_px"]

    client.post(f"{suggested}/place-rest/accept", json={"ids": [1, 2]})
    assert radius() == 7.0
    place(client, suggested, 2, at=(205, 60))
    assert radius() is None
    client.post(f"{suggested}/undo", json={})
    assert radius() == 7.0


def test_a_photo_that_was_placed_meanwhile_stays_where_it_is(client, suggested):
    place(client, suggested, 1, at=(5, 6))
    answer = client.post(f"{suggested}/place-rest/accept", json={"ids": [1, 2]})
    assert answer.json["placed"] == [2]
    photos = {p["id"]: p for p in client.get(suggested).json["photos"]}
    assert photos[1]["x_px"] == 5


def test_what_is_not_suggested_cannot_be_accepted(client, suggested):
    answer = client.post(f"{suggested}/place-rest/accept", json={"ids": [1, 3]})
    assert answer.status_code == 404
    assert answer.json["error"]["message"] == "no place is suggested for this photo"
    photos = {p["id"]: p for p in client.get(suggested).json["photos"]}
    assert photos[1]["x_px"] is None


def correction(id, before, *, heading_deg):
    at = MapPixel(before.x + 30.0, before.y)
    return CorrectedPlace(id, f"photos/{id}.jpg", at, before, 30.0, 6.0, 4.0, heading_deg)


@pytest.fixture
def corrected(yard, library):
    """The same, with three photos placed by GPS, and corrections for two of them."""
    url, slug = yard
    plane_from_pixel = [[0.2, 0.0, 470_683.0], [0.0, -0.2, 6_696_811.0], [0.0, 0.0, 1.0]]
    stated = {"plane": "EPSG:32635", "plane_from_pixel": plane_from_pixel, "method": "corners"}
    with library.database.write() as session:
        session.query(MapRecord).filter_by(slug=slug).one().georeference = stated
        for photo in session.query(Photo).filter(Photo.id > 0):
            at = MapPixel(50.0 * photo.id, 60.0)
            photo.gps_lat, photo.gps_lon = parse_georeference(stated, where=slug).latlon_of(at)
            photo.x_px, photo.y_px = at
    report = RestReport(
        (),
        (),
        (),
        (),
        (
            correction(1, MapPixel(50.0, 60.0), heading_deg=45.0),
            correction(2, MapPixel(100.0, 60.0), heading_deg=None),
        ),
    )
    (library.map_folder(slug) / "derived").mkdir(exist_ok=True)
    stored.keep(library.cfg(slug), report, revision=3)
    return url


def test_photos_placed_by_gps_are_corrected_in_one_step(client, corrected):
    found = client.get(f"{corrected}/place-rest").json["corrected"]
    assert [(one["id"], one["name"], one["moved_m"]) for one in found] == [
        (1, "1.jpg", 6.0),
        (2, "2.jpg", 6.0),
    ]
    answer = client.post(f"{corrected}/place-rest/correct", json={"ids": [1, 2]})
    assert answer.json["placed"] == [1, 2]
    photos = {p["id"]: p for p in client.get(corrected).json["photos"]}
    assert (photos[1]["x_px"], photos[1]["heading_deg"]) == (80.0, 45.0)
    assert photos[1]["radius_px"] == 4.0
    assert client.get(f"{corrected}/place-rest").json["corrected"] == []
    client.post(f"{corrected}/undo", json={})
    photos = {p["id"]: p for p in client.get(corrected).json["photos"]}
    assert (photos[1]["x_px"], photos[2]["x_px"]) == (50.0, 100.0)


def test_a_photo_that_somebody_has_moved_is_not_corrected(client, corrected):
    place(client, corrected, 2, at=(5, 6))
    assert [one["id"] for one in client.get(f"{corrected}/place-rest").json["corrected"]] == [1]
    answer = client.post(f"{corrected}/place-rest/correct", json={"ids": [1, 2]})
    assert answer.json["placed"] == [1]
    assert {p["id"]: p for p in client.get(corrected).json["photos"]}[2]["x_px"] == 5


def test_a_photo_without_a_correction_is_refused(client, corrected):
    answer = client.post(f"{corrected}/place-rest/correct", json={"ids": [1, 3]})
    assert answer.status_code == 404
    assert answer.json["error"]["message"] == "no correction is suggested for this photo"


def test_looking_for_places_is_a_job(client, yard, library):
    answer = client.post(f"{yard[0]}/place-rest")
    assert answer.status_code == 202
    with library.database.read() as session:
        job = session.get(Job, answer.json["job"])
    assert job.kind in KINDS
    assert job.kind == "place-rest"


def test_without_the_extra_it_is_said_at_once(client, yard, absent):
    absent("sfm")
    answer = client.post(f"{yard[0]}/place-rest")
    assert answer.status_code == 422
    assert answer.json["error"]["hint"] == install_line("sfm")
    assert client.get(f"{yard[0]}/place-rest").json["job"] is None
