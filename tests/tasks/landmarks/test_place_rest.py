"""Photos of a rendered court: those in the tray are placed by three placed ones."""

from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import UnplacedPhoto
from webapp.errors import Cancelled, MissingPart, UsageError
from webapp.extras import install_line
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import reconstruct
from webapp.tasks.landmarks.accept import accept_in_folder
from webapp.tasks.landmarks.place_rest import suggest_rest


def suggest(cfg, progress=None):
    return suggest_rest(cfg, settings=Settings(), progress=progress or Progress())


def turned(one, other):
    return abs((one - other + 180.0) % 360.0 - 180.0)


def test_the_rest_is_placed_where_it_was_taken(court):
    report = suggest(court.cfg)
    assert [one.id for one in report.suggested] == [1, 2, 3, 5, 6, 7]
    for one in report.suggested:
        assert np.hypot(*(one.position - court.at[one.id])) < 1.0
        assert turned(one.heading_deg, court.headings[one.id]) < 1.0
        assert 0.5 < one.radius_px < 20.0
        assert set(one.placed_by) == {0, 4, 8}
    assert [(one.id, one.residual_px < 1.0, one.contradicts) for one in report.checked] == [
        (0, True, False),
        (4, True, False),
        (8, True, False),
    ]


def test_a_photo_from_elsewhere_stays_with_the_reason(court):
    (left,) = suggest(court.cfg).left
    assert (left.id, left.reason) == (9, "too few photos overlap enough")


def test_nothing_is_computed_twice_and_only_what_is_new_is_added(court, counted, monkeypatch):
    def no_mapping(*_, **__):
        raise AssertionError("joined again")

    with monkeypatch.context() as patch:
        patch.setattr(reconstruct, "run_mapper", no_mapping)
        again = counted()
        before = suggest(court.cfg, again)
    assert again.sizes == [10, 0]
    the_map = read_map(court.cfg)
    first = replace(the_map, unplaced=tuple(p for p in the_map.unplaced if p.id != 3))
    write_map(court.cfg, first)
    assert [one.id for one in suggest(court.cfg).suggested] == [1, 2, 5, 6, 7]
    write_map(court.cfg, the_map)
    more = counted()
    after = suggest(court.cfg, more)
    assert more.sizes == [10, 0, 9], "they are joined again, so their points have colours again"
    assert [one.id for one in after.suggested] == [one.id for one in before.suggested]


def test_stopped_it_goes_on_where_it_was(court, counted):
    class Stopped(Progress):
        steps = 0

        def advance(self, steps=1):
            self.steps += steps

        def cancelled(self):
            return self.steps > 15

    (court.cfg.parent / "derived" / "map" / "landmarks" / "matches.db").unlink()
    with pytest.raises(Cancelled):
        suggest(court.cfg, Stopped())
    rest = counted()
    report = suggest(court.cfg, rest)
    assert 0 < rest.sizes[1] < 45
    assert len(report.suggested) == 6


def test_a_damaged_database_is_made_anew(court):
    folder = court.cfg.parent / "derived" / "map" / "landmarks"
    (folder / "matches.db").write_bytes(b"SQLite format 3\0" + bytes(5000))
    (folder / "pieces.arrays").write_bytes(b"?")
    assert len(suggest(court.cfg).suggested) == 6


def test_too_few_placed_photos_are_told_with_what_to_add(court):
    the_map = read_map(court.cfg)
    write_map(court.cfg, replace(the_map, experiences=the_map.experiences[:1]))
    report = suggest(court.cfg)
    assert report.suggested == ()
    reasons = {one.id: one.reason for one in report.left}
    assert reasons[1].endswith("other photos, but only one of them is placed")
    assert next(one for one in report.left if one.id == 1).join == report.place_next
    assert report.place_next == (7,)


def test_a_photo_outside_the_image_is_told(court):
    the_map = read_map(court.cfg)
    moved = [
        replace(e, position=MapPixel(e.position.x - 230.0, e.position.y)) for e in the_map.experiences[:2]
    ]
    write_map(court.cfg, replace(the_map, experiences=tuple(moved)))
    outside = {one.id: one.reason for one in suggest(court.cfg).left}
    assert outside[7].startswith("it would be outside the image, at x -")


def test_a_damaged_photo_is_told_and_the_others_are_placed(court):
    (court.cfg.parent / "photos" / "06.png").write_bytes(b"no photo")
    report = suggest(court.cfg)
    assert 6 in {one.id for one in report.left}
    assert len(report.suggested) == 5


def test_photos_none_of_which_can_be_read_are_told_with_the_reason(tmp_path, make_map):
    cfg = make_map(tmp_path, 3)
    the_map = read_map(cfg)
    tray = tuple(UnplacedPhoto(e.id, e.photo) for e in the_map.experiences[1:])
    write_map(cfg, replace(the_map, experiences=the_map.experiences[:1], unplaced=tray))
    for photo in (tmp_path / "photos").iterdir():
        photo.write_bytes(b"no photo")
    report = suggest(cfg)
    assert (report.suggested, report.place_next) == ((), ())
    assert [one.id for one in report.left] == [1, 2]
    assert all("not an image" in one.reason for one in report.left)


def test_a_map_without_a_tray_is_told(court):
    write_map(court.cfg, replace(read_map(court.cfg), unplaced=()))
    with pytest.raises(UsageError, match="no photo without a place"):
        suggest(court.cfg)


def test_a_missing_extra_is_told(court, absent):
    absent("sfm")
    with pytest.raises(MissingPart, match="pycolmap is not installed") as missing:
        suggest(court.cfg)
    assert missing.value.hint == install_line("sfm")


def test_accepted_photos_are_in_the_files(court):
    report = suggest(court.cfg)
    accept_in_folder(court.cfg, report.suggested[:2])
    the_map = read_map(court.cfg)
    assert [e.id for e in the_map.experiences] == [0, 1, 2, 4, 8]
    assert [photo.id for photo in the_map.unplaced] == [3, 5, 6, 7, 9]
    placed = the_map.experiences[1]
    assert np.hypot(*(placed.position - court.at[1])) < 1.0
    assert turned(placed.heading_deg, court.headings[1]) < 1.0


def test_a_photo_that_is_placed_wrongly_is_where_the_others_have_it(court):
    accept_in_folder(court.cfg, suggest(court.cfg).suggested)
    whole = read_map(court.cfg)
    by_hand = [replace(e, radius_px=None) for e in whole.experiences]
    wrong = tuple(
        replace(e, position=MapPixel(e.position.x + 90.0, e.position.y)) if e.id == 3 else e for e in by_hand
    )
    write_map(court.cfg, replace(whole, experiences=wrong, unplaced=()))
    with pytest.raises(UsageError, match="no photo without a place"):
        suggest(court.cfg)
    report = suggest_rest(court.cfg, settings=Settings(), progress=Progress(), check=True)
    assert [one.id for one in report.checked if one.contradicts] == [3]
    (found,) = (one for one in report.checked if one.id == 3)
    assert found.residual_px == pytest.approx(90.0, abs=1.0)
    assert np.hypot(*(found.predicted - court.at[3])) < 1.0
    assert all(one.residual_px < 2.0 for one in report.checked if one.id != 3)


def test_photos_placed_by_gps_are_corrected_by_all_together(court):
    rng = np.random.default_rng(1)
    accept_in_folder(court.cfg, suggest(court.cfg).suggested)
    whole = read_map(court.cfg)
    by_gps = tuple(
        replace(
            e,
            position=MapPixel(*(e.position + rng.normal(0.0, 8.0, 2))),
            heading_deg=None if e.id else 5.0,
            gps_accuracy_m=0.1 * 1.515 * 8.0,
            by_gps=True,
            radius_px=None,
        )
        for e in whole.experiences
    )
    tenth = Georeference(
        "EPSG:32635", (0.1, 0.0, 470_683.0, 0.0, -0.1, 6_696_811.0, 0.0, 0.0, 1.0), "corners"
    )
    write_map(court.cfg, replace(whole, experiences=by_gps, unplaced=(), georeference=tenth))
    corrected = {one.id: one for one in suggest(court.cfg).corrected}
    assert len(corrected) == len(by_gps)
    off = np.array(
        [[np.hypot(*(at - court.at[e.id])) for at in (e.position, corrected[e.id].position)] for e in by_gps]
    )
    before, after = np.sqrt((off**2).mean(0))
    assert after < 0.6 * before
    assert corrected[1].moved_m == pytest.approx(0.1 * corrected[1].moved_px, rel=0.01)
    assert corrected[0].heading_deg is None
    assert turned(corrected[1].heading_deg, court.headings[1]) < 5.0
