"""`expmap map place-rest` for people and scripts, with synthetic suggestions."""

import json
from dataclasses import replace

import pytest

from webapp.cli import place_rest
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import UnplacedPhoto
from webapp.files.maps.folder import read_map, write_map
from webapp.store.library import open_library
from webapp.store.maps import edits
from webapp.store.schema import Account, Photo
from webapp.tasks.landmarks.photo_pieces import PhotoGap, PiecesReport
from webapp.tasks.landmarks.place_rest import (
    CheckedPhoto,
    CorrectedPlace,
    LeftPhoto,
    RestReport,
    SuggestedPlace,
)
from webapp.tasks.maps import adopt_map

FIRST, SECOND = MapPixel(100.0, 90.0), MapPixel(40.0, 300.0)
"""Positions of photos placed by GPS."""

REPORT = RestReport(
    suggested=(
        SuggestedPlace(2, "photos/2.jpg", MapPixel(290.0, 110.5), 12.0, 45.0, (0, 1)),
        SuggestedPlace(3, "photos/3.jpg", MapPixel(410.0, 90.0), 80.0, None, (1,), is_checked=False),
    ),
    left=(LeftPhoto(4, "photos/4.jpg", "too few photos overlap enough", (0,)),),
    checked=(
        CheckedPhoto(0, "photos/0.jpg", 3.5, False, MapPixel(103.5, 90.0)),
        CheckedPhoto(1, "photos/1.jpg", 250.0, True, MapPixel(40.0, 300.25), 14.0, 50.0),
        CheckedPhoto(5, "photos/5.jpg", 30.0, False, MapPixel(7.0, 8.0)),
        CheckedPhoto(6, "photos/6.jpg", None, False),
    ),
    place_next=(3, 4),
    corrected=(
        CorrectedPlace(0, "photos/0.jpg", MapPixel(95.0, 90.0), FIRST, 30.0, 4.0, 10.0, 12.0),
        CorrectedPlace(1, "photos/1.jpg", MapPixel(45.0, 300.0), SECOND, 60.0, 8.0, 10.0, None),
    ),
)


def take_off(cfg):
    """Move all photos but the first two of a map to its tray."""
    the_map = read_map(cfg)
    tray = tuple(UnplacedPhoto(e.id, e.photo) for e in the_map.experiences[2:])
    write_map(cfg, replace(the_map, experiences=the_map.experiences[:2], unplaced=tray))


@pytest.fixture
def cfg(tmp_path, make_map, monkeypatch):
    """A map of two placed photos and three in the tray with suggestions."""
    cfg = make_map(tmp_path / "library" / "park", 5)
    take_off(cfg)
    monkeypatch.setattr(place_rest, "suggest_rest", lambda *_, **__: REPORT)
    return cfg


def test_photos_placed_by_gps_are_moved_when_asked(expmap, cfg):
    the_map = read_map(cfg)
    first = replace(the_map.experiences[0], position=FIRST, by_gps=True)
    write_map(cfg, replace(the_map, experiences=(first, *the_map.experiences[1:])))
    _, _, err = expmap("map", "place-rest", cfg)
    assert (
        "2 photos placed by GPS would be moved by --correct: by 6.0 m on average, at most by 8.0 m "
        "(photos/1.jpg)" in err
    )
    assert read_map(cfg).experiences[0] == first
    code, _, err = expmap("map", "place-rest", cfg, "--correct")
    assert code == 0
    assert "2 photos placed by GPS were moved" in err
    moved, stayed = read_map(cfg).experiences
    assert (moved.position, moved.heading_deg, moved.by_gps) == ((95.0, 90.0), 12.0, False)
    assert moved.radius_px == 10.0
    assert stayed.position == the_map.experiences[1].position  # placed by hand


def test_suggestions_are_printed_and_nothing_is_changed(expmap, cfg):
    before = cfg.read_bytes()
    code, out, err = expmap("map", "place-rest", cfg)
    assert code == 0
    assert out.splitlines() == [
        "photos/2.jpg  x 290.0, y 110.5, within 12.0 px, heading 45 degrees",
        "photos/3.jpg  x 410.0, y 90.0, within 80.0 px",
        "photos/4.jpg  too few photos overlap enough",
    ]
    assert (
        "photos/1.jpg (id 1) contradicts the other placed photos: they put it 250 px (14 m) to the north-east"
        in err
    )
    assert "2 photos joined, 1 not" in err
    assert "1 of them follow from two placed photos, which do not show how far off they are" in err
    assert "help most (ids): 3, 4" in err
    assert cfg.read_bytes() == before


def test_json_has_everything(expmap, cfg):
    code, out, _ = expmap("map", "place-rest", cfg, "--json")
    told = json.loads(out)
    assert code == 0
    assert told["photos"][0] == {
        "id": 2,
        "photo": "photos/2.jpg",
        "x_px": 290.0,
        "y_px": 110.5,
        "radius_px": 12.0,
        "heading_deg": 45.0,
        "placed_by": [0, 1],
        "is_checked": True,
        "accepted": False,
    }
    assert told["photos"][2] == {
        "id": 4,
        "photo": "photos/4.jpg",
        "error": "too few photos overlap enough",
        "place_first": [0],
    }
    assert [photo["contradicts"] for photo in told["checked"]] == [False, True, False, False]
    assert told["checked"][1] == {
        "id": 1,
        "photo": "photos/1.jpg",
        "residual_px": 250.0,
        "residual_m": 14.0,
        "x_px": 40.0,
        "y_px": 300.25,
        "bearing_deg": 50.0,
        "contradicts": True,
    }
    assert told["checked"][3]["x_px"] is None
    assert told["place_next"] == [3, 4]


def test_placed_photos_are_checked_those_that_contradict_the_others_first(expmap, cfg):
    before = cfg.read_bytes()
    code, out, _ = expmap("map", "place-rest", cfg, "--check")
    assert code == 0
    assert out.splitlines() == [
        "photos/1.jpg  250.0 px (14.0 m) from where the others put it, x 40.0, y 300.2; contradicts them",
        "photos/5.jpg  30.0 px from where the others put it, x 7.0, y 8.0",
        "photos/0.jpg  3.5 px from where the others put it, x 103.5, y 90.0",
    ]
    assert cfg.read_bytes() == before
    code, _, err = expmap("map", "place-rest", cfg, "--check", "--accept")
    assert code == 2
    assert "--check changes nothing" in err


def test_photos_within_a_radius_are_accepted_in_the_files(expmap, cfg):
    code, out, err = expmap("map", "place-rest", cfg, "--accept", "--within", 20)
    assert code == 0
    assert "heading 45 degrees; placed" in out
    assert "1 not, 1 placed" in err
    the_map = read_map(cfg)
    assert the_map.experiences[2].position == MapPixel(290.0, 110.5)
    assert [photo.id for photo in the_map.unplaced] == [3, 4]


def test_a_map_of_the_library_gets_one_edit(expmap, cfg, make_map, tmp_path):
    library = open_library(tmp_path / "library")
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    make_map(library.map_folder("yard"), 5)
    map_id = adopt_map.adopt_map(library, "yard", account_id=account.id)
    nowhere = {f"photo/{id}": {"x_px": None, "y_px": None} for id in (2, 3, 4)}
    with library.changing(map_id) as change:
        edits.apply(change.session, change.record, changes=nowhere, kind="place", account_id=account.id)
    code, *_ = expmap("map", "place-rest", library.cfg("yard"), "--accept")
    assert code == 0
    with library.changing(map_id) as change:
        photos = [change.session.get(Photo, (map_id, id)) for id in (2, 3, 4)]
        assert [photo.x_px for photo in photos] == [290.0, 410.0, None]
        assert photos[0].heading_deg == 45.0
        assert edits.undo(change.session, change.record, account_id=account.id)
        assert [photo.x_px for photo in photos] == [None, None, None]
    library.database.close()


def test_a_limit_without_accepting_is_refused(expmap, cfg):
    code, _, err = expmap("map", "place-rest", cfg, "--within", 20)
    assert code == 2
    assert "--within can only be used with --accept" in err


PIECES = PiecesReport(
    revision=1,
    names={n: f"photos/{n}.jpg" for n in range(5)},
    pieces=((0, 1, 2),),
    alone=(3,),
    bridges=(2,),
    gaps=(PhotoGap(3, 2, 14), PhotoGap(3, 1, 0)),
    place_next=(0, 2),
    failed={4: "it is not an image"},
)


def test_pieces_are_listed_with_the_photos_between_which_others_are_missing(expmap, cfg, monkeypatch):
    monkeypatch.setattr(place_rest.photo_pieces, "check_pieces", lambda *_, **__: PIECES)
    code, out, err = expmap("map", "place-rest", cfg, "--pieces")
    assert code == 0
    assert out.splitlines() == [
        "piece 1: 3 photos, photos/0.jpg, photos/1.jpg, photos/2.jpg",
        "in no piece: photos/3.jpg",
        "almost connects pieces: photos/2.jpg",
        "take photos between photos/3.jpg and photos/2.jpg: they share 14 points",
        "take photos between photos/3.jpg and photos/1.jpg: they show nothing in common",
    ]
    assert "1 piece of 3 photos, photos in none: 1" in err
    assert "place these photos by hand first (ids): 0, 2" in err
    assert "warning: photos/4.jpg (id 4): it is not an image" in err
    code, out, _ = expmap("map", "place-rest", cfg, "--pieces", "--json")
    assert code == 0
    assert json.loads(out) == {
        "revision": 1,
        "pieces": [[0, 1, 2]],
        "alone": [3],
        "bridges": [2],
        "gaps": [{"photo": 3, "other": 2, "matches": 14}, {"photo": 3, "other": 1, "matches": 0}],
        "place_next": [0, 2],
        "failed": [{"id": 4, "reason": "it is not an image"}],
    }


def test_pieces_are_only_looked_at(expmap, cfg):
    code, _, err = expmap("map", "place-rest", cfg, "--pieces", "--accept")
    assert code == 2
    assert "--pieces cannot be used with --accept, --correct or --check" in err
