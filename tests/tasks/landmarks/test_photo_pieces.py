"""Which photos can be joined is known before any is placed; only new photos are compared again."""

import json
from dataclasses import replace

from webapp.core.mapmodel.model import UnplacedPhoto
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import photo_pieces
from webapp.tasks.landmarks.photo_pieces import check_pieces
from webapp.tasks.localize.index_location import landmarks_folder


def check(cfg, progress=None):
    return check_pieces(cfg, settings=Settings(), progress=progress or Progress())


def move_all_to_tray(cfg):
    the_map = read_map(cfg)
    tray = [UnplacedPhoto(e.id, e.photo, fov_deg=e.fov_deg) for e in the_map.experiences]
    write_map(cfg, replace(the_map, experiences=(), unplaced=(*tray, *the_map.unplaced)))


def test_pieces_are_those_of_the_reconstruction_before_any_photo_is_placed(court):
    move_all_to_tray(court.cfg)
    before = court.cfg.read_bytes()
    report = check(court.cfg)
    assert [sorted(piece) for piece in report.pieces] == [list(range(9))]
    assert report.alone == (9,)
    assert len(set(report.place_next)) == 2
    assert court.cfg.read_bytes() == before


def test_a_missing_photo_makes_two_pieces_with_a_gap_where_it_was(court):
    the_map = read_map(court.cfg)
    kept = (0, 1, 2, 3, 6, 7, 8)
    write_map(
        court.cfg,
        replace(
            the_map,
            experiences=tuple(e for e in the_map.experiences if e.id in kept),
            unplaced=tuple(p for p in the_map.unplaced if p.id in kept),
        ),
    )
    report = check(court.cfg)
    assert {id for piece in report.pieces for id in piece} | {*report.alone} == set(kept)
    assert len(report.gaps) == len(report.pieces) - 1 + len(report.alone)


def test_nothing_is_compared_twice(court, monkeypatch):
    first = check(court.cfg)

    def compared_again(*_):
        raise AssertionError("compared again")

    with monkeypatch.context() as patch:
        patch.setattr(photo_pieces, "_compare", compared_again)
        assert check(court.cfg) == first
    pairs = landmarks_folder(court.cfg) / "pieces" / "pairs.json"
    pairs.write_text("{", encoding="utf-8")
    assert check(court.cfg) == first
    assert json.loads(pairs.read_text(encoding="utf-8"))["pairs"]


def test_an_unreadable_photo_is_named_and_a_map_of_one_photo_is_no_piece(court):
    the_map = read_map(court.cfg)
    (court.cfg.parent / the_map.unplaced[0].photo).write_bytes(b"not an image")
    lost = the_map.unplaced[0].id
    report = check(court.cfg)
    assert lost in report.failed
    assert all(lost not in piece for piece in (*report.pieces, report.alone))
    write_map(court.cfg, replace(the_map, experiences=the_map.experiences[:1], unplaced=()))
    assert check(court.cfg).pieces == ()


def test_the_report_is_kept_for_the_page(court):
    assert photo_pieces.read(court.cfg) is None
    report = check(court.cfg)
    photo_pieces.keep(court.cfg, report)
    stored = photo_pieces.read(court.cfg)
    assert {**stored, "version": None} == {**photo_pieces.as_json(report), "version": None}
