"""A model that has drifted is brought to the positions that are known."""

import numpy as np
import pytest

from tests.files.landmarks.drifted_walk import PHOTOS, drifted, walk
from webapp.core.landmarks.similarity import fit_similarity
from webapp.files.landmarks import adjust as adjusting
from webapp.files.landmarks.adjust import AdjustJob, adjust
from webapp.files.landmarks.colmap import as_model


@pytest.fixture
def model(tmp_path):
    """The folder of the model, and its centres in order."""
    found = drifted(np.random.default_rng(3))
    folder = tmp_path / "model"
    folder.mkdir()
    found.write(folder)
    return folder, in_order(as_model(found))


def in_order(model):
    return model.centre[[model.contents.index(str(number)) for number in range(PHOTOS)]]


def job(model, tmp_path, *, known, at):
    folder, own = model
    return AdjustJob(
        folder,
        tmp_path / "out",
        tuple(str(number) for number in range(PHOTOS)),
        fit_similarity(own[known], at),
        tuple(str(number) for number in known),
        at,
        np.tile([0.1, 0.1, 5.0], (len(known), 1)),
    )


def test_a_walk_that_bends_is_straightened_by_five_positions(model, tmp_path):
    truth, known = walk()[0], np.array([0, 5, 11, 16, 21])
    asked = job(model, tmp_path, known=known, at=truth[known])
    before = np.linalg.norm(asked.similarity.apply(model[1]) - truth, axis=1)
    after = np.linalg.norm((in_order(adjust(asked)) - truth)[:, :2], axis=1)
    assert np.median(before) > 1.5
    assert after.max() < 0.15
    assert (tmp_path / "out" / "images.bin").exists()


def test_one_wrong_position_does_not_pull_the_others(model, tmp_path):
    truth, known = walk()[0], np.arange(0, PHOTOS, 3)
    at = truth[known] + np.where(known == 12, 9.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    after = in_order(adjust(job(model, tmp_path, known=known, at=at)))
    assert np.linalg.norm((after - truth)[:, :2], axis=1).max() < 0.15  # no map says how high a camera is
    assert np.linalg.norm((after[12] - at[4])[:2]) == pytest.approx(9.0, abs=0.2)


def test_a_piece_whose_photos_would_not_agree_any_more_stays_as_it_is(model, tmp_path, monkeypatch):
    monkeypatch.setattr(adjusting, "_WORSE", 0.0)
    monkeypatch.setattr(adjusting, "_WORSE_PX", 0.1)
    truth, known = walk()[0], np.array([0, 5, 16, 21])
    assert adjust(job(model, tmp_path, known=known, at=truth[known])) is None
    assert not (tmp_path / "out").exists()
