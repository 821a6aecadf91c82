"""Street-level photos are added to a map with positions, headings and licences, without duplicates."""

import os
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest

from tests.street_server import picture
from tests.tasks.street.conftest import PLACE, at
from webapp import __version__
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.tilegrid import GeoBox
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.model import PhotoSource
from webapp.errors import Busy, Cancelled, InputError, NotFound, TooMany, UsageError
from webapp.files.lock import exclusive
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings, UploadLimits
from webapp.store.schema import Photo
from webapp.tasks.maps.photo_files import sweep_uploads
from webapp.tasks.street.survey import FolderTarget, PixelBox, StreetRequest, survey_street


def with_street(settings, **changes):
    return replace(settings, street=replace(settings.street, **changes))


def by_source(cfg):
    return {e.source.id: e for e in read_map(cfg).experiences if e.source is not None}


def test_photos_of_panoramax_are_placed_with_all_that_is_known(bring, cfg, service):
    survey, report = bring()
    assert (survey.found, len(survey.wanted), report.added, report.failed) == (3, 3, 3, ())
    assert survey.licences == {"CC-BY-SA-4.0": 3} and survey.authors == 1
    photos = by_source(cfg)
    assert photos["a1"].position == pytest.approx((50, 40), abs=1e-6)
    assert [photos[id].heading_deg for id in ("a1", "b2", "c3")] == [90.0, None, 350.0]
    first = photos["a1"]
    assert (first.fov_deg, first.gps_accuracy_m) == (70.0, 1.5)
    assert first.taken_at == "2025-04-12T02:14:55.000+00:00"
    page = f"{service.base}/#focus=pic&pic=a1"
    assert first.source == PhotoSource("Panoramax", "a1", "CC-BY-SA-4.0", "Ana", page)
    assert (cfg.parent / first.photo).read_bytes() == picture("a1")
    assert service.agents == {f"experience-map/{__version__} (photos of one area for a map)"}
    assert "/photo/a1/sd" in service.asked, "no more pixels than a map uses"


def test_photos_of_mapillary_are_where_structure_from_motion_has_them(bring, cfg, service):
    _, report = bring("mapillary")
    assert report.added == 3
    first = by_source(cfg)["a1"]
    assert first.position == pytest.approx((50, 40), abs=1e-6)
    assert first.heading_deg == 90.0 and first.fov_deg == pytest.approx(90.0)
    assert by_source(cfg)["b2"].heading_deg == 1.0, "of the compass, where nothing better is known"
    assert first.source.credit == "© ben, Mapillary (CC BY-SA 4.0)"
    assert first.taken_at == "2025-04-12T02:14:55.000+00:00"
    tokens = {token for (path, token) in service.tokens if path.startswith("/photo/")}
    assert len(tokens) == 1, "the photos of the test are on the service's own host"


def test_what_the_map_has_is_not_asked_for_again(bring, service, cfg):
    bring()
    survey, report = bring()
    assert (survey.known, survey.wanted, report.added) == (3, (), 0)
    assert set(service.photos_asked().values()) == {1}
    service.shots.append(at(10, 10, "d4"))
    _, report = bring()
    assert report.added == 1
    assert service.photos_asked() == {"a1": 1, "b2": 1, "c3": 1, "d4": 1}
    ids = [e.id for e in read_map(cfg).experiences]
    assert ids == [0, 1, 2, 3, 4, 5]


def test_the_same_file_under_another_name_is_not_added(bring, cfg):
    (cfg.parent / "photos" / "1.jpg").write_bytes(picture("b2"))
    _, report = bring()
    assert (report.added, report.duplicates) == (2, 1)


def test_only_the_area_and_the_image_count(bring, service):
    service.shots += [at(150, 250, "south"), at(-20, 50, "west")]
    survey, _ = bring(area=GeoBox(50.101, 50.0981, 14.4, 14.4016))
    assert [one.photo.id for one in survey.wanted] == ["a1", "b2"] and survey.outside == 0
    survey, _ = bring(area=PixelBox(140.0, -50.0, 400.0, 130.0))
    assert [one.photo.id for one in survey.wanted] == ["c3"] and survey.known == 1


def test_photos_beside_a_turned_image_are_counted(bring, cfg, service):
    turned = replace(PLACE, plane_from_pixel=(1e-5, 1e-5, 14.4, 1e-5, -1e-5, 50.1, 0, 0, 1))
    write_map(cfg, replace(read_map(cfg), georeference=turned))
    del service.shots[2]
    for shot, pixel in zip(service.shots, [(-20, 100), (150, 100)], strict=True):
        shot.lat, shot.lon = turned.latlon_of(MapPixel(*pixel))
    survey, _ = bring()
    assert [one.photo.id for one in survey.wanted] == ["b2"]
    assert (survey.outside, survey.found) == (1, 2)


@pytest.mark.parametrize(
    ("area", "words"),
    [
        (GeoBox(50.0, 50.1, 14.4, 14.5), "empty"),
        (GeoBox(10.0, 9.0, 14.4, 14.5), "not on the map's image"),
        (GeoBox(50.1, 50.0, 15.4, 15.5), "not on the map's image"),
        (PixelBox(400.0, 0.0, 500.0, 10.0), "not on the map's image"),
    ],
)
def test_an_area_elsewhere_is_refused_and_nobody_is_asked(bring, service, area, words):
    with pytest.raises(UsageError, match=words):
        bring(area=area)
    assert not service.asked


def test_a_map_across_the_180th_meridian(bring, cfg, service):
    around_180 = "+proj=webmerc +datum=WGS84 +lon_0=180 +units=m +no_defs"
    across = Georeference(around_180, (1, 0, -150, 0, -1, 6_000_000, 0, 0, 1), "corners")
    write_map(cfg, replace(read_map(cfg), georeference=across))
    for shot, pixel in zip(service.shots, [(50, 40), (150, 120), (250, 60)], strict=True):
        shot.lat, shot.lon = across.latlon_of(MapPixel(*pixel))
    assert service.shots[0].lon > 179 and service.shots[2].lon < -179
    survey, _ = bring(area=GeoBox(50.0, 40.0, 179.0, -179.0))
    assert len(survey.wanted) == 3


def test_without_georeference_one_sentence(bring, cfg, service):
    write_map(cfg, replace(read_map(cfg), georeference=None))
    with pytest.raises(UsageError, match="the map has no georeference"):
        bring()
    assert not service.asked


def test_off_until_it_is_set_up(cfg, service):
    target = FolderTarget(cfg, settings=Settings())
    for source, needed in (("panoramax", "street.panoramax"), ("mapillary", "street.mapillary_token")):
        with pytest.raises(NotFound, match="is not set up here") as refused:
            request = StreetRequest(source)
            survey_street(target, request, settings=Settings().street, progress=Progress())
        assert needed in refused.value.hint
    assert not service.asked


class TestPanoramas:
    @pytest.fixture(autouse=True)
    def panorama(self, service):
        service.shots[0].panorama = True
        service.shots[0].azimuth = 300.0

    def test_they_are_cut_into_views_with_headings_of_their_own(self, bring, cfg, service):
        survey, report = bring()
        assert survey.panoramas == 1 and report.added == 8
        views = {id: e for id, e in by_source(cfg).items() if id.startswith("a1#")}
        turns = {int(id.removeprefix("a1#")): round(e.heading_deg) for id, e in views.items()}
        assert turns == {0: 300, 60: 0, 120: 60, 180: 120, 240: 180, 300: 240}
        assert {round(e.fov_deg) for e in views.values()} == {91}
        assert all(e.source.author == "Ana" and e.source.licence == "CC-BY-SA-4.0" for e in views.values())
        assert service.asked["/photo/a1/hd"] == 1
        assert not list(cfg.parent.rglob("*a1.jpg")), "the panorama itself does not stay"
        again, _ = bring()
        assert again.known == 3

    def test_where_some_views_are_missing_only_these_are_added(self, bring, cfg):
        bring()
        whole = read_map(cfg)
        some = tuple(e for e in whole.experiences if e.source is None or e.source.id != "a1#120")
        write_map(cfg, replace(whole, experiences=some))
        _, report = bring()
        assert report.added == 1 and "a1#120" in by_source(cfg)

    def test_they_can_be_left_out_or_kept(self, bring, cfg):
        survey, report = bring(panoramas="skip")
        assert (survey.skipped, report.added) == (1, 2)
        _, report = bring(panoramas="keep")
        assert report.added == 1 and by_source(cfg)["a1"].heading_deg == 300.0
        survey, _ = bring(panoramas="cut")
        assert survey.known == 3, "it is in the map as a whole"

    def test_one_that_is_none_is_reported(self, bring, service):
        service.bodies["/photo/a1/hd"] = picture("a1")
        _, report = bring()
        (failed,) = report.failed
        assert failed.id == "a1" and "not a full panorama" in failed.reason and report.added == 2


class TestLists:
    def test_pages_are_followed(self, bring, service):
        service.page_size = 2
        survey, _ = bring()
        assert survey.found == 3
        pages = [query.get("page", ["0"])[0] for path, query in service.queries if path == "/api/search"]
        assert pages == ["0", "2"]

    def test_a_full_answer_without_a_next_one_is_asked_again_in_quarters(self, bring, service, monkeypatch):
        monkeypatch.setattr("webapp.net.street.Mapillary.page_size", 2)
        survey, _ = bring("mapillary")
        assert survey.found == 3
        assert service.asked["/images"] >= 5

    def test_too_many_are_refused(self, bring, service, settings):
        with pytest.raises(UsageError, match="more than 2 photos"):
            bring(settings=with_street(settings, max_photos=2))
        assert not service.photos_asked()

    def test_pages_in_a_circle_end(self, bring, service):
        loop = b'{"features": [], "links": [{"rel": "next", "href": "/api/search?again"}]}'
        service.bodies["/api/search"] = loop
        with pytest.raises(InputError, match="keeps returning more pages"):
            bring()

    @pytest.mark.parametrize(
        "fields",
        [
            {"license": None},
            {"license": 5},
            {"pers:interior_orientation": [1]},
        ],
    )
    def test_a_photo_that_is_described_badly_is_left_out_and_counted(self, bring, service, fields):
        service.shots[0].fields = fields
        survey, report = bring()
        assert (survey.unusable, survey.found, report.added) == (1, 3, 2)

    def test_odd_facts_are_unknown(self, bring, cfg, service):
        odd = {"datetime": "soon", "view:azimuth": "east", "quality:horizontal_accuracy": -3}
        service.shots[0].fields = odd
        bring()
        photo = by_source(cfg)["a1"]
        assert (photo.taken_at, photo.heading_deg, photo.gps_accuracy_m) == (None, None, None)

    @pytest.mark.parametrize(
        "body", [b"<html>", b"[]", b'{"features": 5}', b'{"links": []}', b'{"features": [], "links": 5}']
    )
    def test_what_is_no_list_is_one_sentence(self, bring, service, body):
        service.bodies["/api/search"] = body
        with pytest.raises(InputError, match="Panoramax did not send a list of photos"):
            bring()

    def test_the_next_page_is_on_the_same_host(self, bring, service):
        away = b'{"features": [], "links": [{"rel": "next", "href": "http://127.0.0.1:1/api/search"}]}'
        service.bodies["/api/search"] = away
        with pytest.raises(InputError, match="leads to another host"):
            bring()


class TestPoliteness:
    def test_few_at_once(self, bring, service, settings):
        service.shots += [at(5 * n + 20, 100, f"x{n}") for n in range(6)]
        service.delay_s = 0.02
        bring(settings=with_street(settings, parallel=2))
        assert service.most_at_once <= 2

    def test_it_waits_as_long_as_it_is_asked(self, bring, service, monkeypatch):
        pauses = []
        monkeypatch.setattr("webapp.net.polite.RateLimit.pause", lambda _, seconds: pauses.append(seconds))
        service.failing["/api/search"] = [429, 503]
        service.retry_after = "7"
        _, report = bring()
        assert report.added == 3 and pauses == [7.0, 7.0]

    def test_a_long_pause_ends_the_work_and_nothing_is_lost(self, bring, service, cfg, settings):
        one = with_street(settings, parallel=1)
        service.failing["/photo/b2/sd"] = [429]
        service.retry_after = "86400"
        with pytest.raises(TooMany, match="asks for a pause of 86400 seconds"):
            bring(settings=one)
        assert set(by_source(cfg)) == {"a1"}
        service.retry_after = None
        _, report = bring(settings=one)
        assert report.added == 2
        assert service.photos_asked() == {"a1": 1, "b2": 2, "c3": 1}

    @pytest.mark.parametrize("status", [401, 403])
    def test_a_refusal_is_one_sentence(self, bring, service, status):
        service.failing["/images"] = [status]
        with pytest.raises(InputError, match=rf"Mapillary refused access \({status}\)") as refused:
            bring("mapillary")
        assert "token" in refused.value.hint
        assert service.asked["/images"] == 1

    def test_a_token_goes_to_no_other_host_and_a_host_must_be_allowed(self, bring, service, settings):
        with_other = with_street(settings, photo_hosts="photos.example")
        service.redirects["/photo/a1/2048"] = "https://127.0.0.2:1/x.jpg"
        _, report = bring("mapillary", settings=with_other)
        (failed,) = report.failed
        assert failed.id == "a1" and "127.0.0.2, which is not allowed" in failed.reason
        assert report.added == 2

    def test_a_service_that_is_down_is_tried_four_times(self, bring, service, monkeypatch):
        monkeypatch.setattr("webapp.net.polite.RateLimit.pause", lambda *_: None)
        service.failing["/api/search"] = [500] * 9
        with pytest.raises(InputError, match="Panoramax answered 500"):
            bring()
        assert service.asked["/api/search"] == 4


class TestDamage:
    def test_a_photo_that_fails_is_named_and_the_others_come(self, bring, service, cfg):
        service.failing["/photo/a1/sd"] = [404]
        service.bodies["/photo/b2/sd"] = b"<html>"
        service.bodies["/photo/c3/sd"] = picture("c3")[:-200]
        service.shots.append(at(20, 20, "d4"))
        _, report = bring()
        assert report.added == 1 and {one.id for one in report.failed} == {"a1", "b2", "c3"}
        assert set(by_source(cfg)) == {"d4"}
        assert not list((cfg.parent / "derived" / "street").glob("*.jpg")), "a damaged file is fetched again"
        service.bodies.clear()
        assert bring()[1].added == 3

    def test_a_photo_that_is_cut_off_on_its_way_is_tried_again(self, bring, service, monkeypatch):
        monkeypatch.setattr("webapp.net.polite.RateLimit.pause", lambda *_: None)
        service.cut.add("/photo/a1/sd")
        _, report = bring()
        assert [one.id for one in report.failed] == ["a1"] and "cannot be reached" in report.failed[0].reason
        assert service.asked["/photo/a1/sd"] == 4

    def test_after_three_failures_in_a_row_the_others_are_not_asked_for(self, bring, service, settings):
        service.shots = [at(20 * n + 10, 50, f"x{n}") for n in range(8)]
        service.failing = {f"/photo/x{n}/sd": [410] for n in range(8)}
        with pytest.raises(InputError, match="answered 410"):
            bring(settings=with_street(settings, parallel=1))
        assert len(service.photos_asked()) <= 4

    def test_one_at_a_time_for_a_map(self, bring, cfg):
        lock = FolderTarget(cfg, settings=Settings()).scratch("adding.lock")
        with exclusive(lock, doing=""), pytest.raises(Busy, match="already"):
            bring()


def test_the_lock_outlives_the_sweep_of_old_files(bring, library, library_target, settings):
    bring(target=library_target)
    assert sweep_uploads(library, settings=replace(settings, upload=UploadLimits(keep_hours=0.0))) == 0
    assert [path.name for path in library.uploads.iterdir()] == ["street-1-adding.lock"]


class Stop(Progress):
    """Cancels after the first photo."""

    done = 0

    def advance(self, steps=1):
        self.done += steps

    def cancelled(self):
        return self.done >= 1


def test_stopped_work_goes_on_where_it_was(bring, service, cfg):
    with pytest.raises(Cancelled):
        bring(progress=Stop())
    there = set(by_source(cfg))
    assert 0 < len(there) < 3
    _, report = bring()
    assert report.added == 3 - len(there)
    assert max(service.photos_asked().values()) <= 2 and len(by_source(cfg)) == 3


KILLED = """
import os, signal, sys
from dataclasses import replace
from pathlib import Path
from webapp.cli.street import street_photos
from webapp.tasks.street.survey import FolderTarget
take = FolderTarget.take
def take_and_die(self, photo):
    take(self, photo)
    os.kill(os.getpid(), signal.SIGKILL)
FolderTarget.take = take_and_die
street_photos([sys.argv[1]])
"""


def test_killed_work_goes_on_and_nothing_comes_twice(bring, service, cfg, settings):
    variables = {
        "EXPMAP_STREET_PANORAMAX": service.base,
        "EXPMAP_STREET_REQUESTS_PER_SECOND": "1000",
        "EXPMAP_STREET_PARALLEL": "1",
    }
    ended = subprocess.run(
        [sys.executable, "-c", KILLED, cfg],
        env={**os.environ, **variables},
        stdin=subprocess.DEVNULL,
        check=False,
    )
    assert ended.returncode == -signal.SIGKILL
    assert set(by_source(cfg)) == {"a1"}
    _, report = bring(settings=with_street(settings, parallel=1))
    assert report.added == 2
    names = Counter(e.photo for e in read_map(cfg).experiences)
    assert len(names) == 5 and set(names.values()) == {1}
    asked = service.photos_asked()
    assert asked["a1"] == 1 and max(asked.values()) <= 2


def test_a_map_that_changed_meanwhile_keeps_the_change(bring, cfg, settings):
    target = FolderTarget(cfg, settings=settings)
    moved = read_map(cfg)
    first = replace(moved.experiences[0], position=MapPixel(7.0, 9.0))
    write_map(cfg, replace(moved, experiences=(first, *moved.experiences[1:])))
    _, report = bring(target=target)
    assert report.added == 3
    assert read_map(cfg).experiences[0].position == (7.0, 9.0)


def test_a_photo_that_was_removed_does_not_come_back(bring, library_target, photos, library, map_id):
    bring(target=library_target)
    with library.database.write() as session:
        session.get_one(Photo, (map_id, photos()["panoramax-a1.jpg"].id)).removed = True
    survey, report = bring(target=library_target)
    assert (survey.known, report.added) == (3, 0)
    assert photos()["panoramax-a1.jpg"].removed


def test_in_a_library_they_are_photos_like_all_others(bring, library_target, photos, library, map_id):
    survey, report = bring(target=library_target)
    assert (len(survey.wanted), report.added) == (3, 3)
    first = photos()["panoramax-a1.jpg"]
    assert (first.x_px, first.y_px) == pytest.approx((50, 40), abs=1e-6)
    assert (first.heading_deg, first.fov_deg, first.gps_accuracy_m) == (90.0, 70.0, 1.5)
    assert LatLon(first.gps_lat, first.gps_lon) == pytest.approx(PLACE.latlon_of((50, 40)))
    assert first.source["author"] == "Ana" and first.gps_problem is None
    assert not list(library.uploads.glob("street-*.jpg"))
    again, _ = bring(target=library_target)
    assert again.known == 3
