"""Segments: features of photos on disk."""

import math
from dataclasses import replace

import numpy as np
import pytest

from webapp.core.features.types import Features
from webapp.core.retrieval.engines.types import PhotoEntry
from webapp.errors import IndexDamaged
from webapp.files.localize.arrays import read_arrays, write_arrays
from webapp.files.localize.features import read_segment, write_segment


def photo(rows: int, *, number: int, fov_deg: float = math.nan) -> PhotoEntry:
    rng = np.random.default_rng(number)
    features = Features(
        xy=rng.random((rows, 2), np.float32),
        size=rng.random(rows, np.float32),
        angle=rng.random(rows, np.float32),
        descriptors=rng.integers(0, 256, (rows, 32), np.uint8),
        photo_size=(640 + number, 480),
    )
    return PhotoEntry(f"{number:064x}", fov_deg, features)


def same(a: PhotoEntry, b: PhotoEntry) -> bool:
    arrays = ("xy", "size", "angle", "descriptors")
    return (
        a.content == b.content
        and (a.fov_deg == b.fov_deg or (math.isnan(a.fov_deg) and math.isnan(b.fov_deg)))
        and a.features.photo_size == b.features.photo_size
        and all(np.array_equal(getattr(a.features, n), getattr(b.features, n)) for n in arrays)
    )


@pytest.mark.parametrize("mapped", [True, False])
def test_photos_come_out_as_they_went_in(tmp_path, mapped):
    entries = [photo(5, number=0), photo(0, number=1, fov_deg=61.5), photo(9, number=2)]
    name = write_segment(tmp_path / "{hash}.features", entries)
    segment = read_segment(tmp_path / f"{name}.features", mapped=mapped)
    assert len(segment.content) == 3
    assert all(same(segment.entry(i), e) for i, e in enumerate(entries))


def of_network(entry: PhotoEntry) -> PhotoEntry:
    """As of a network: all keypoints have one size and no angle."""
    rows = len(entry.features)
    one_size, no_angle = np.full(rows, 32.0, np.float32), np.zeros(rows, np.float32)
    return replace(entry, features=replace(entry.features, size=one_size, angle=no_angle))


@pytest.mark.parametrize("in_file", [True, False])
def test_sizes_and_angles_that_are_all_equal_take_no_space_and_come_out_as_they_went_in(tmp_path, in_file):
    plain = [photo(400, number=0), photo(0, number=1), photo(600, number=2)]
    entries = [of_network(entry) for entry in plain]
    write_segment(tmp_path / "plain", plain)
    write_segment(tmp_path / "one", entries)
    segment = read_segment(tmp_path / "one", in_file=in_file)
    assert all(same(segment.entry(i), e) for i, e in enumerate(entries))
    saved = (tmp_path / "plain").stat().st_size - (tmp_path / "one").stat().st_size
    assert saved == pytest.approx(8 * 1000, abs=256)


def make_two_values(arrays):
    arrays["one_size"] = arrays["one_size"].repeat(2)


def make_no_value(arrays):
    arrays["one_angle"] = arrays["one_angle"][:0]


@pytest.mark.parametrize("change", [make_two_values, make_no_value])
def test_not_one_value_for_all_is_damage(tmp_path, change):
    write_segment(tmp_path / "a", [of_network(photo(3, number=0))])
    arrays, meta = read_arrays(tmp_path / "a", mapped=False)
    change(arrays)
    write_arrays(tmp_path / "b", arrays, meta=meta)
    with pytest.raises(IndexDamaged, match="expmap build"):
        read_segment(tmp_path / "b")


def test_a_segment_of_photos_without_features(tmp_path):
    write_segment(tmp_path / "a", [photo(0, number=4)])
    segment = read_segment(tmp_path / "a")
    assert segment.descriptors.shape == (0, 32)
    assert len(segment.entry(0).features) == 0


def test_unmapped_segments_keep_no_file_open(tmp_path):
    write_segment(tmp_path / "a", [photo(3, number=0)])
    segment = read_segment(tmp_path / "a", mapped=False)
    base = segment.descriptors
    while base is not None:
        assert not isinstance(base, np.memmap)
        base = base.base if isinstance(base, np.ndarray) else None


def change_first(arrays):
    arrays["first"] = np.array([0, 900])


def shorten(arrays):
    arrays["angle"] = arrays["angle"][:1]


def leave_out(arrays):
    del arrays["size"]


def add(arrays):
    arrays["colour"] = np.zeros(3)


def reverse(arrays):
    arrays["first"] = np.array([0, 5, 2, 3])


def bare(arrays):
    arrays["descriptors"] = arrays["descriptors"].reshape(-1)


@pytest.mark.parametrize("change", [change_first, shorten, leave_out, add, reverse, bare])
def test_arrays_that_do_not_fit_each_other_are_damage(tmp_path, change):
    write_segment(tmp_path / "a", [photo(1, number=0), photo(1, number=1), photo(1, number=2)])
    arrays, meta = read_arrays(tmp_path / "a", mapped=False)
    change(arrays)
    write_arrays(tmp_path / "b", arrays, meta=meta)
    with pytest.raises(IndexDamaged, match="expmap build"):
        read_segment(tmp_path / "b")


def test_other_arrays_are_not_a_segment(tmp_path):
    write_arrays(tmp_path / "a", {"x": np.arange(3)}, meta={})
    with pytest.raises(IndexDamaged, match="features"):
        read_segment(tmp_path / "a")
