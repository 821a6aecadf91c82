"""Submodels of the court are adjusted by the placed photos."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geo.types import MapPixel
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import adjust
from webapp.tasks.landmarks.accept import accept_in_folder
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.mapping import ADJUSTED, run_adjustment
from webapp.tasks.landmarks.place_rest import suggest_rest
from webapp.tasks.landmarks.reconstruct import reconstruct
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

pytestmark = pytest.mark.slow


def joined(cfg):
    return reconstruct(cfg, read_map(cfg), settings=Settings(), progress=Progress())


def adjusted(cfg):
    return adjust_submodels(joined(cfg), read_map(cfg), progress=Progress())


def place_all(court, *, moved=()):
    report = suggest_rest(court.cfg, settings=Settings(), progress=Progress())
    accept_in_folder(court.cfg, report.suggested)
    the_map = read_map(court.cfg)
    by_hand = [replace(e, radius_px=None) for e in the_map.experiences]
    wrong = [
        replace(e, position=MapPixel(e.position.x, e.position.y + 90.0)) if e.id in moved else e
        for e in by_hand
    ]
    write_map(court.cfg, replace(the_map, experiences=tuple(wrong)))


@pytest.fixture(scope="module")
def adjusted_court(joined_court, tmp_path_factory):
    """The court with all its photos placed and adjusted; read-only."""
    folder = tmp_path_factory.mktemp("adjusted") / "court"
    shutil.copytree(joined_court.cfg.parent, folder)
    court = joined_court._replace(cfg=folder / "map.cfg")
    place_all(court)
    adjusted(court.cfg)
    return court


@pytest.fixture
def cfg(adjusted_court, tmp_path):
    """Its map, in a copy that a test may change."""
    shutil.copytree(adjusted_court.cfg.parent, tmp_path / "adjusted")
    return tmp_path / "adjusted" / "map.cfg"


def test_the_adjusted_world_is_the_map_and_a_wrong_position_stands_out(court):
    place_all(court, moved=[3])
    found, (submodel,) = adjusted(court.cfg)
    assert submodel.problem == ""
    residual = {found.photos[n].id: off for n, off in submodel.residual_px.items()}
    assert residual.pop(3) == pytest.approx(90.0, abs=1.5)
    assert max(residual.values()) < 1.5
    (rigid,) = found.submodels
    for number, centre in zip(rigid.photo, rigid.centre, strict=True):
        assert np.hypot(*(centre[:2] - court.at[found.photos[number].id])) < 1.5


def test_it_is_kept_until_positions_change(court, monkeypatch):
    place_all(court)
    before = joined(court.cfg)
    found, _ = adjusted(court.cfg)
    assert np.abs(before.submodels[0].centre - found.submodels[0].centre).max() > 1.0
    with monkeypatch.context() as patched:
        patched.setattr(adjust, "run_adjustment", None)
        again, _ = adjusted(court.cfg)
        np.testing.assert_array_equal(again.submodels[0].centre, found.submodels[0].centre)
    moved = read_map(court.cfg)
    first, *others = moved.experiences
    first = replace(first, position=MapPixel(first.position.x + 2.0, first.position.y))
    write_map(court.cfg, replace(moved, experiences=(first, *others)))
    after, _ = adjusted(court.cfg)
    assert np.abs(after.submodels[0].centre - found.submodels[0].centre).max() > 0.01
    localizer = open_pipeline(
        court.cfg, OpenOptions(method="landmarks"), settings=Settings(), progress=Progress()
    )
    first = localizer.localize(court.cfg.parent / "photos" / "05.png", top=1).hypotheses[0]
    assert np.hypot(*(first.position - court.at[5])) < 2.0


def test_each_position_is_predicted_by_an_adjustment_without_it(court):
    place_all(court, moved=[3])
    found, _ = adjusted(court.cfg)
    (submodel,) = found.submodels
    there = dict(zip(submodel.photo.tolist(), submodel.left_out, strict=True))
    off = {
        found.photos[number].id: float(np.hypot(*(place[:2] - court.at[found.photos[number].id])))
        for number, place in there.items()
        if np.isfinite(place[0])
    }
    assert len(off) >= 4
    assert max(off.values()) < 3.0, "also of the wrong position: the others predict where it was taken"
    again, _ = adjusted(court.cfg)
    np.testing.assert_array_equal(again.submodels[0].left_out, submodel.left_out)


def test_an_adjustment_that_contradicts_the_positions_is_refused(court, monkeypatch):
    place_all(court)
    before = joined(court.cfg).submodels[0].centre

    def shifted(job, *, progress):
        model = run_adjustment(job, progress=progress)
        return replace(model, centre=model.centre + np.array([40.0, 0.0, 0.0]))

    monkeypatch.setattr(adjust, "run_adjustment", shifted)
    found, (submodel,) = adjusted(court.cfg)
    assert submodel.problem == "the photos do not agree with the positions"
    np.testing.assert_array_equal(found.submodels[0].centre, before)
    assert [*(found.folder / ADJUSTED).glob("*")] == []


@pytest.mark.parametrize(
    ("shift", "problem"),
    [(None, "3 positions are known, 4 are needed"), ("line", "the known positions are in a line")],
)
def test_a_submodel_stays_as_it_is_where_positions_are_too_few_or_in_a_line(court, shift, problem):
    if shift == "line":
        the_map = read_map(court.cfg)
        first, *_, last = the_map.experiences
        ends = np.array([first.position, last.position])
        tray = [photo for photo in the_map.unplaced if photo.id in (3, 5)]
        accept = suggest_rest(court.cfg, settings=Settings(), progress=Progress()).suggested
        accept_in_folder(court.cfg, [one for one in accept if one.id in {p.id for p in tray}])
        the_map = read_map(court.cfg)
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        placed = [
            replace(e, position=MapPixel(*(ends[0] + along * ((np.array(e.position) - ends[0]) @ along))))
            for e in the_map.experiences
        ]
        write_map(court.cfg, replace(the_map, experiences=tuple(placed)))
    before = joined(court.cfg).submodels[0].centre
    found, (submodel,) = adjusted(court.cfg)
    assert submodel.problem == problem
    np.testing.assert_array_equal(found.submodels[0].centre, before)


def test_a_photo_that_was_removed_takes_no_part_any_more(cfg):
    the_map = read_map(cfg)
    write_map(cfg, replace(the_map, experiences=the_map.experiences[:-1]))
    found, (submodel,) = adjusted(cfg)
    assert submodel.problem == ""
    assert {found.photos[n].id for n in submodel.photos} <= {e.id for e in the_map.experiences[:-1]}


def test_the_model_of_earlier_positions_is_removed_when_there_is_another(cfg):
    found, _ = adjusted(cfg)
    (first,) = (found.folder / "adjusted").iterdir()
    the_map = read_map(cfg)
    one, *others = the_map.experiences
    moved = replace(one, position=MapPixel(one.position.x + 2.0, one.position.y))
    write_map(cfg, replace(the_map, experiences=(moved, *others)))
    adjusted(cfg)
    (second,) = (found.folder / "adjusted").iterdir()
    assert first.name != second.name
    write_map(cfg, the_map)
    adjusted(cfg)
    assert first.joinpath("images.bin").exists()
