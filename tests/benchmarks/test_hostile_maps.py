"""Zips and lists that name few things very often: derived from their seed, and most are valid zips."""

import io
import random
import zipfile

import pytest

from benchmarks import hostile_maps


@pytest.mark.parametrize("kind", sorted(set(hostile_maps.KINDS) - {"one photo in many spellings"}))
def test_a_zip_follows_from_its_seed_and_has_a_map(kind):
    make = hostile_maps.KINDS[kind]
    data = make(random.Random(2))
    assert data == make(random.Random(2))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert "map.cfg" in archive.namelist()


def test_all_kinds_of_zips_and_lists_are_made(monkeypatch):
    monkeypatch.setattr(hostile_maps, "KINDS", {kind: lambda _, k=kind: k for kind in hostile_maps.KINDS})
    assert {hostile_maps.crowded_zip(random.Random(n)) for n in range(200)} == set(hostile_maps.KINDS)
    lists = [hostile_maps.crowded_list(random.Random(n)) for n in range(30)]
    assert lists == [hostile_maps.crowded_list(random.Random(n)) for n in range(30)]
    assert {name.rpartition(".")[2] for name, _ in lists} == {"csv", "json", "kml"}
