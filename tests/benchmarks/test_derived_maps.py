"""Derived maps are complete, and derived as their names say."""

import sys

import numpy as np
import pytest

from benchmarks import derived_maps
from webapp.files.maps.folder import read_map

pytestmark = pytest.mark.slow


@pytest.fixture
def table(sample_folder):
    return derived_maps.read(sample_folder)


def test_areas_share_positions_and_queries_lie_in_them(table):
    found = derived_maps.areas(table)
    distinct = {tuple(p) for p in found.position.tolist()}
    assert 2 <= len(distinct) <= len(table.photos) // derived_maps.PLACES_PER_AREA
    assert {tuple(p) for p in found.truth.tolist()} <= distinct


def test_a_quarter_of_the_photos_is_left(table):
    assert len(derived_maps.thin(table).photos) == len(table.photos) // 4


def test_lanes_are_not_to_scale(table):
    found = derived_maps.snake(table)
    assert (np.diff(found.position, axis=0) != 0).any(1).all()
    assert {tuple(p) for p in found.truth.tolist()} <= {tuple(p) for p in found.position.tolist()}


def test_two_maps_stand_one_below_the_other(table):
    joined = derived_maps.join(table, table)
    assert len(joined.photos) == 2 * len(table.photos)
    assert joined.position[len(table.photos) :, 1].min() >= table.size[1]


def test_the_command_writes_maps_that_can_be_read(sample_folder, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["derived_maps", str(sample_folder.parent), str(tmp_path)])
    derived_maps.main()
    made = sorted(folder.name for folder in tmp_path.iterdir())
    assert made == sorted(f"{sample_folder.name}-{n}" for n in [*derived_maps.DERIVED, "dim"])
    for name in made:
        folder = tmp_path / name
        experiences = read_map(folder / "map.cfg").experiences
        assert experiences and all((folder / e.photo).exists() for e in experiences)
        assert len(derived_maps.read(folder).queries) > 0
