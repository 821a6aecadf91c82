"""A calibration is kept while the map is nearly unchanged, and repeated otherwise."""

from dataclasses import replace

import pytest

from tests.opening import open_first_look
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.calibration import DEFAULT
from webapp.core.localize.verified import find_places
from webapp.files.localize import adopted
from webapp.files.localize import calibration as calibrationfile
from webapp.files.localize.adopted import AdoptedPhoto
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import calibrate, trials
from webapp.tasks.localize.plan import OpenOptions


@pytest.fixture
def cfg(make_map, tmp_path):
    return make_map(tmp_path / "map", 12)


@pytest.fixture
def made(monkeypatch):
    """Count calibrations, without computing any."""
    count = []
    monkeypatch.setattr(calibrate, "run_trials", lambda opened, **_: {})
    monkeypatch.setattr(calibrate, "fit_trials", lambda indexed, tried: count.append(1) or DEFAULT)
    return count


def open_and_calibrate(cfg, **options):
    opened = open_first_look(
        cfg, OpenOptions(features="orb", **options), settings=Settings(), progress=Progress()
    )
    calibrate.calibrate_map(opened, progress=Progress())


def move(cfg, *, by, photos):
    the_map = read_map(cfg)
    moved = [
        replace(e, position=MapPixel(e.position.x + by, e.position.y)) if e.id < photos else e
        for e in the_map.experiences
    ]
    write_map(cfg, replace(the_map, experiences=tuple(moved)))


def test_the_same_map_keeps_it(cfg, made):
    for _ in range(3):
        open_and_calibrate(cfg)
    assert len(made) == 1


def test_a_few_moved_photos_keep_it_and_many_do_not(cfg, made):
    open_and_calibrate(cfg)
    move(cfg, by=1.0, photos=12)
    open_and_calibrate(cfg)
    assert len(made) == 1
    move(cfg, by=400.0, photos=6)
    open_and_calibrate(cfg)
    assert len(made) == 2


@pytest.mark.parametrize("options", [{"right_within_px": 50.0}, {"map_fov_deg": 40.0}])
def test_other_options_need_another(cfg, made, options):
    open_and_calibrate(cfg)
    open_and_calibrate(cfg, **options)
    assert len(made) == 2


def test_a_killed_calibration_continues_where_it_was(cfg, monkeypatch):
    class Killed(BaseException):
        pass

    tried = []
    try_one = trials._try

    def counted(indexed, photo, *how, **more):
        if len(tried) == 5:
            raise Killed
        tried.append(photo)
        return try_one(indexed, photo, *how, **more)

    monkeypatch.setattr(trials, "_try", counted)
    opened = open_first_look(cfg, OpenOptions(features="orb"), settings=Settings(), progress=Progress())
    with pytest.raises(Killed):
        calibrate.calibrate_map(opened, progress=Progress())
    monkeypatch.setattr(trials, "_try", lambda *a, **k: tried.append(a[1]) or try_one(*a, **k))
    stored = calibrate.calibrate_map(opened, progress=Progress())
    assert sorted(tried) == list(range(12))
    whole = [*trials.try_photos(trials.TriedMap(opened.indexed), Progress()).values()]
    assert stored.calibration == calibrate.fit_trials(opened.indexed, whole)


def test_a_newer_format_of_calibrations_takes_the_trials_that_there_are(cfg, monkeypatch):
    opened = open_first_look(cfg, OpenOptions(features="orb"), settings=Settings(), progress=Progress())
    first = calibrate.calibrate_map(opened, progress=Progress())
    monkeypatch.setattr(calibrationfile, "FORMAT", calibrationfile.FORMAT + 1)
    monkeypatch.setattr(trials, "_try", lambda *a, **k: pytest.fail("tried again"))
    again = calibrate.calibrate_map(opened, progress=Progress())
    assert again.calibration == first.calibration


def test_adopted_photos_repeat_it_when_many_more_are_known(cfg, made, monkeypatch):
    monkeypatch.setattr(trials.TriedMap, "attempt_adopted", lambda tried, photo: None)
    counts = []
    for known in (0, 1, 2, 3, 4, 0):
        cfg.parent.joinpath("derived").mkdir(exist_ok=True)
        adopted.write(cfg, [AdoptedPhoto(id, id) for id in range(known)])
        open_and_calibrate(cfg)
        counts.append(len(made))
    assert counts == [1, 2, 3, 3, 4, 5]


def test_an_adopted_photo_is_tried_on_the_map_as_it_was(cfg):
    opened = open_first_look(cfg, OpenOptions(features="orb"), settings=Settings(), progress=Progress())
    hidden = []

    def find(features, *, fov_deg, hide):
        hidden.append(hide)
        return find_places(opened.indexed, features, fov_deg=fov_deg, hide=hide)

    tried = trials.TriedMap(opened.indexed, find=find)
    record = tried.attempt_adopted(AdoptedPhoto(3, 9))
    assert hidden == [[3, 9, 10, 11]]
    assert trials.Trial.from_record(record).hidden == "later"
    assert tried.attempt_adopted(AdoptedPhoto(99, 9)) is None, "it is not in the index"
    assert tried.attempt_adopted(AdoptedPhoto(0, 0)) is None, "nothing remains"
