"""Accepting suggestions, correcting GPS and landmarks on demand survive kills between any two writes."""

import math
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.killing import Step, run_until
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage, UnplacedPhoto
from webapp.files.maps import folder
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import edits, maps
from webapp.store.schema import Edit, MapRecord, Photo
from webapp.tasks.landmarks import accept, on_demand
from webapp.tasks.landmarks.accept import accept_in_folder, correct_in_folder
from webapp.tasks.landmarks.place_rest import CorrectedPlace, SuggestedPlace
from webapp.tasks.maps import adopt_map

PLACED = Experience(0, "0.jpg", MapPixel(5.0, 5.0))
FACTS = {"gps_accuracy_m": 4.0, "note": "Left of the gate."}
TRAY = tuple(UnplacedPhoto(id, f"{id}.jpg", heading_deg=90.0, **FACTS) for id in (1, 2))
BEFORE = Map(SatelliteImage("s.png", 90, 90), (PLACED,), next_id=3, unplaced=TRAY)
SUGGESTED = [SuggestedPlace(1, "1.jpg", MapPixel(50.5, 60.0), 7.0, 45.0, (0,))]


class Killed(BaseException):
    """Stands for a kill: no code of the program runs after it."""


@contextmanager
def killed_before(module, name, *, calls=0):
    """Kill the program when it calls a function, after a number of calls."""
    done = []
    usual = getattr(module, name)

    def call(*args, **options):
        if len(done) == calls:
            raise Killed
        done.append(args)
        return usual(*args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, name, call)
        yield


@pytest.mark.parametrize("writes", range(4))
def test_no_photo_is_lost_when_accepting_is_killed(tmp_path, writes):
    cfg = tmp_path / "map.cfg"
    write_map(cfg, BEFORE)
    with killed_before(folder, "write_bytes", calls=writes), pytest.raises(Killed):
        accept_in_folder(cfg, SUGGESTED)
    found = read_map(cfg)
    there = {e.id for e in found.experiences}
    assert there | {photo.id for photo in found.unplaced} == {0, 1, 2}
    assert 1 in there or TRAY[0] in found.unplaced
    accept_in_folder(cfg, SUGGESTED)
    assert_accepted(cfg)


def test_accepting_takes_no_more_writes_than_those(tmp_path):
    cfg = tmp_path / "map.cfg"
    write_map(cfg, BEFORE)
    with killed_before(folder, "write_bytes", calls=4):
        accept_in_folder(cfg, SUGGESTED)
    assert_accepted(cfg)


def assert_accepted(cfg):
    found = read_map(cfg)
    placed = Experience(1, "1.jpg", MapPixel(50.5, 60.0), heading_deg=45.0, radius_px=7.0, **FACTS)
    assert found.experiences == (PLACED, placed)
    assert found.unplaced == TRAY[1:]


def accept_both(folder, url, map_id, account_id):
    library = open_library(folder, url=url)
    places = [
        SuggestedPlace(id, f"photos/{id}.jpg", MapPixel(50.0 * id, 60.0), 7.0, 45.0, (0,)) for id in (1, 2)
    ]
    accept.accept_in_library(library, map_id, suggested=places, account_id=account_id)
    library.database.close()


def test_all_or_none_are_placed_when_accepting_in_a_library_is_killed(
    new_library, make_map, tmp_path, database_url
):
    library = new_library(tmp_path / "library")
    make_map(library.map_folder("row"), 3)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session).id
    id = adopt_map.adopt_map(library, "row", account_id=owner)
    nowhere = {f"photo/{photo}": {"x_px": None, "y_px": None} for photo in (1, 2)}
    with library.changing(id) as change:
        edits.apply(change.session, change.record, changes=nowhere, kind="place", account_id=owner)

    def found():
        with library.database.read() as session:
            photos = maps.photos(session, session.get_one(MapRecord, id))
            return [one.is_placed for one in photos], session.query(Edit).filter_by(kind="place-rest").count()

    arguments = library.folder, database_url, id, owner
    assert run_until(
        Step("webapp.tasks.landmarks.accept:place_spots", is_after=True), accept_both, *arguments
    )
    assert found() == ([True, False, False], 0)
    assert run_until(
        Step("webapp.tasks.landmarks.accept:accept_in_library", is_after=True), accept_both, *arguments
    )
    assert found() == ([True, True, True], 1)
    accept_both(*arguments)
    assert found() == ([True, True, True], 1), "repeated, it changes nothing"
    with library.changing(id) as change:
        assert [change.session.get_one(Photo, (id, n)).x_px for n in (1, 2)] == [50.0, 100.0]
        assert edits.undo(change.session, change.record, account_id=owner)
    assert found()[0] == [True, False, False]


BY_GPS = Experience(3, "3.jpg", MapPixel(20.25, 30.0), gps_accuracy_m=4.0, by_gps=True)
CORRECTED = Experience(3, "3.jpg", MapPixel(25.5, 33.75), heading_deg=10.0, gps_accuracy_m=4.0, radius_px=2.0)


def correct(cfg):
    """Move the photo from its GPS position, as `--correct` does when it is repeated."""
    (now,) = (e for e in read_map(cfg).experiences if e.id == CORRECTED.id)
    assert now.by_gps
    place = CorrectedPlace(3, "3.jpg", CORRECTED.position, now.position, 6.5, 6.5, 2.0, 10.0)
    correct_in_folder(cfg, [place])


@pytest.mark.parametrize("writes", range(3))
def test_no_position_passes_for_a_more_exact_one_when_correcting_is_killed(tmp_path, writes):
    cfg = tmp_path / "map.cfg"
    before = replace(BEFORE, experiences=(PLACED, BY_GPS), next_id=4)
    write_map(cfg, before)
    with killed_before(folder, "write_bytes", calls=writes), pytest.raises(Killed):
        correct(cfg)
    first, found = read_map(cfg).experiences
    assert first == PLACED and read_map(cfg).unplaced == TRAY
    assert found.by_gps and found.radius_px is None and found.gps_accuracy_m == 4.0
    assert min(math.dist(found.position, at) for at in (BY_GPS.position, CORRECTED.position)) < 0.6
    correct(cfg)
    assert read_map(cfg) == replace(before, experiences=(PLACED, CORRECTED))


@pytest.fixture
def part(tmp_path, monkeypatch):
    """Reconstructs a part of a map, with stand-ins for slow steps."""
    found = SimpleNamespace(submodels=("a piece",))
    monkeypatch.setattr(on_demand, "reconstruct", lambda *_, **__: found)
    monkeypatch.setattr(on_demand, "adjust_submodels", lambda *_, **__: None)
    cfg = tmp_path / "map.cfg"

    def run(*photos):
        return on_demand.reconstruct_part(
            cfg, BEFORE, photos=photos, settings=Settings(), progress=Progress()
        )

    return SimpleNamespace(cfg=cfg, run=run)


def test_a_part_counts_only_once_all_of_it_is_there(part):
    with killed_before(on_demand, "write_text"), pytest.raises(Killed):
        part.run(PLACED)
    assert on_demand.part_of(part.cfg, [PLACED]) is None
    assert on_demand.part_around(part.cfg, [PLACED]) is None
    assert part.run(PLACED) == on_demand.part_around(part.cfg, [PLACED])


def test_a_part_that_is_half_removed_serves_nobody(part, monkeypatch):
    monkeypatch.setattr(on_demand, "MOST_PARTS", 1)
    part.run(PLACED)
    with killed_before(on_demand.shutil, "rmtree"), pytest.raises(Killed):
        part.run(Experience(9, "9.jpg", MapPixel(1.0, 1.0)))
    assert on_demand.part_around(part.cfg, [PLACED]) is None
