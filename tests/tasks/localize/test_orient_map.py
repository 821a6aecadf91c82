"""Orientations of the sample map's photos: correct, stored, and computed only for new photos."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.opening import open_first_look
from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MIN_TRUST, empty_depths
from webapp.core.localize.verified import find_places
from webapp.core.reconstruction import pairs as pairs_module
from webapp.core.reconstruction.depths import DepthsExcluding
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.errors import Cancelled
from webapp.files.localize import orientations
from webapp.files.localize.orientations import StoredOrientations
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.plan import OpenOptions

SETTINGS = Settings(extract=ExtractSettings(max_side_px=640, keypoints=600))


def opened(cfg):
    return open_first_look(cfg, OpenOptions(jobs=1), settings=SETTINGS, progress=Progress())


def oriented(cfg, progress=None):
    return orient_map.estimate_orientations(opened(cfg), progress=progress or Progress())


def with_index_of(found):
    """Return the stored orientations without depths."""
    known = oriented(found.cfg).indexed.extrinsics
    return StoredOrientations(
        replace(known, depths=empty_depths()),
        found.contents,
        found.indexed.position,
        f"{found.map_hash} None",
    )


class Counting(Progress):
    """Counts the photos, and stops after some of them."""

    def __init__(self, stop_after=math.inf):
        self.done, self.total, self.stop_after = 0, 0, stop_after

    def size(self, total):
        self.total += total

    def advance(self, steps=1):
        self.done += steps

    def cancelled(self):
        return self.done >= self.stop_after


@pytest.fixture(scope="module")
def indexed_sample(sample_folder, tmp_path_factory):
    """A copy of the sample with its index and orientations."""
    folder = tmp_path_factory.mktemp("oriented") / "sample"
    shutil.copytree(sample_folder, folder, ignore=shutil.ignore_patterns("derived"))
    oriented(folder / "map.cfg")
    return folder / "map.cfg"


@pytest.fixture
def cfg(indexed_sample, tmp_path):
    shutil.copytree(indexed_sample.parent, tmp_path / "map")
    return tmp_path / "map" / "map.cfg"


def headings_off(cfg, found):
    """Return the errors of headings, degrees, of trusted photos, relative to the rendered ones."""
    result = json.loads((cfg.parent / "map.json").read_text(encoding="utf-8"))["experiences"]
    truth = {int(e["id"]): math.radians(e["heading_deg"]) for e in result if e.get("heading_deg") is not None}
    held = found.indexed.extrinsics
    known = held.trust >= MIN_TRUST
    off = [
        so3.wrap(so3.heading(held.rotation[i]) - truth[int(id)])
        for i, id in enumerate(found.indexed.ids)
        if known[i] and int(id) in truth
    ]
    return np.abs(np.degrees(np.array(off)))


def test_headings_are_those_the_photos_were_taken_with(cfg):
    off = headings_off(cfg, oriented(cfg))
    assert len(off) >= 10
    assert np.median(off) < 5.0


def test_depths_of_what_several_photos_see_are_kept_with_the_orientations(cfg):
    found = oriented(cfg)
    depths = found.indexed.extrinsics.depths
    assert len(np.unique(depths.photo)) >= 10
    assert (depths.inverse_depth > 0.0).all()
    assert all(depths.row[depths.photo == i].max() < len(found.indexed.features(i)) for i in depths.photo)
    again = orient_map.with_orientations(
        opened(cfg), orient_map.newest(opened(cfg))
    ).indexed.extrinsics.depths
    for name in ("photo", "row", "inverse_depth", "sigma"):
        assert (getattr(again, name) == getattr(depths, name)).all()


def test_a_hidden_photo_has_no_part_in_depths(cfg):
    found = oriented(cfg)
    indexed = found.indexed
    query = int(np.bincount(indexed.extrinsics.depths.photo).argmax())
    features, fov = indexed.features(query), float(indexed.fov_deg[query])
    hidden = np.arange(len(indexed.ids)) == query

    def known(**how):
        places = find_places(indexed, features, fov_deg=fov, **how).places
        return sum(
            np.isfinite(v.inverse_depth).sum() for p in places for v in p.photos if v.matched.photo != query
        )

    hide = indexed.ids[hidden].tolist()
    assert known(hide=hide) == 0  # depths of the others partly come from it
    seen = orient_map.sightings(found)
    without, by_all = (known(hide=hide, depths=d) for d in (DepthsExcluding(seen, hidden), seen.fuse()))
    assert 0 < without < by_all


def test_of_two_photos_with_one_content_the_first_has_the_depths(cfg):
    alone = oriented(cfg).indexed.extrinsics.depths
    twice = int(np.bincount(alone.photo).argmax())
    lines = cfg.read_text().splitlines()
    _, path, x, y, *_ = lines[1 + twice].split(";")
    cfg.write_text("\n".join([*lines, f"{len(lines) - 1};{path};{int(x) + 2};{y}"]) + "\n")
    both = oriented(cfg).indexed
    assert len(both.ids) == len(lines)
    photos = both.extrinsics.depths.photo
    assert (photos == twice).sum() >= 0.9 * (alone.photo == twice).sum()
    assert len(lines) - 1 not in photos


def test_files_of_an_older_program_are_made_again(cfg, monkeypatch):
    found = opened(cfg)
    old = orientations.FORMAT - 1
    with monkeypatch.context() as patch:
        patch.setattr(orientations, "FORMAT", old)
        orientations.write(found.writable / "orientations-ivf.arrays", with_index_of(found))
    assert orient_map.newest(found) is None
    assert len(oriented(cfg).indexed.extrinsics.depths.row)


def test_what_is_stored_of_pairs_gives_the_depths_that_are_kept(cfg):
    found = oriented(cfg)
    kept, again = found.indexed.extrinsics.depths, orient_map.sightings(found).fuse()
    assert (kept.row == again.row).all()
    np.testing.assert_allclose(kept.inverse_depth, again.inverse_depth, rtol=1e-5)
    assert orient_map.sightings(opened(cfg)) is None


def test_what_is_known_is_not_computed_again(cfg):
    counted = Counting()
    oriented(cfg, counted)
    assert counted.total == 0


def test_a_moved_photo_costs_no_new_comparison(cfg):
    lines = cfg.read_text().splitlines()
    first = lines[1].split(";")
    first[2] = str(int(first[2]) + 3)
    cfg.write_text("\n".join([lines[0], ";".join(first), *lines[2:]]) + "\n")
    counted = Counting()
    found = oriented(cfg, counted)
    assert counted.total == 0
    assert found.indexed.extrinsics.trust[0] >= 0.0


def test_a_photo_that_was_moved_far_is_not_trusted_until_it_is_computed_again(cfg):
    found = opened(cfg)
    stored = orient_map.newest(found)
    position = found.indexed.position.copy()
    trusted = int(stored.orientations.trust.argmax())
    position[trusted] += 10.0 * found.indexed.place_radius_px
    moved = replace(found, indexed=replace(found.indexed, position=position))
    trust = orient_map.with_orientations(moved, stored).indexed.extrinsics.trust
    assert trust[trusted] == 0.0
    depths = orient_map.with_orientations(moved, stored).indexed.extrinsics.depths
    assert trusted not in depths.photo
    assert len(depths.photo) == (stored.orientations.depths.photo != trusted).sum()
    assert (np.delete(trust, trusted) == np.delete(stored.orientations.trust, trusted)).all()


def test_stopped_in_between_it_continues(cfg, monkeypatch):
    derived = next(cfg.parent.rglob("orientations-*.arrays")).parent
    whole = oriented(cfg).indexed.extrinsics
    for path in derived.glob("*-ivf.arrays"):
        path.unlink()
    monkeypatch.setattr(orient_map, "_SAVED_EVERY_S", 0.0)
    with pytest.raises(Cancelled):
        oriented(cfg, Counting(stop_after=6))
    rest = Counting()
    again = oriented(cfg, rest).indexed.extrinsics
    assert rest.total == len(whole.trust) - 6
    np.testing.assert_allclose(again.trust, whole.trust, atol=0.2)


def test_a_new_photo_alone_is_compared(cfg):
    found = opened(cfg)
    path = found.writable / "pairs-ivf.arrays"
    stored = orientations.read_pairs(path)
    count = len(stored.contents) - 1
    orientations.write_pairs(path, replace(stored, done=count))
    (found.writable / "orientations-ivf.arrays").unlink()
    counted = Counting()
    oriented(cfg, counted)
    assert counted.total == 1


def test_damaged_files_are_made_again(cfg):
    derived = next(cfg.parent.rglob("orientations-*.arrays")).parent
    for path in derived.glob("*-ivf.arrays"):
        path.write_bytes(path.read_bytes()[:100])
    counted = Counting()
    found = oriented(cfg, counted)
    assert counted.total == len(found.indexed.ids)
    assert headings_off(cfg, found).size >= 10


def test_a_photo_without_features_has_no_pairs(cfg, monkeypatch):
    found = opened(cfg)
    monkeypatch.setattr(type(found.indexed), "features", lambda self, photo: None)
    assert len(pairs_module.match_photo(found.indexed, 0)) == 0


class MutualNearest:
    """Matches mutual nearest neighbours, and counts the calls."""

    weights = "mine"

    def __init__(self):
        self.asked = 0

    def match(self, query, photo):
        self.asked += 1
        there = BruteForce([photo.descriptors], "l2").search(query.descriptors, 1).row[:, 0]
        back = BruteForce([query.descriptors], "l2").search(photo.descriptors, 1).row[:, 0]
        mutual = np.flatnonzero(back[there] == np.arange(len(query)))
        return np.column_stack([mutual, there[mutual]])


LITTLE_KNOWN = 10


@pytest.fixture
def with_network(cfg, monkeypatch):
    """The sample, opened with a method with a network; nothing is known of the first ten photos."""
    monkeypatch.setattr(orient_map, "PAIR_MATCHERS", {"sift": "network"})
    found = opened(cfg)
    path = found.writable / "pairs-ivf.arrays"
    stored = orientations.read_pairs(path)
    little = {stored.contents.index(content) for content in found.contents[:LITTLE_KNOWN]}
    pairs = stored.pairs
    left = np.array(
        [k for k in range(len(pairs)) if not little & {int(pairs.first[k]), int(pairs.second[k])}]
    )
    rest = pairs.subset(left, first=pairs.first[left], second=pairs.second[left])
    orientations.write_pairs(path, replace(stored, pairs=rest))
    (found.writable / "orientations-ivf.arrays").unlink()
    oriented(cfg)
    monkeypatch.setattr(orient_map, "_WELL_KNOWN", 0.01)
    plan, indexed = replace(found.plan, method="thorough"), found.indexed
    return replace(found, plan=plan, indexed=replace(indexed, pair_matcher=MutualNearest()))


def thoroughly(found, progress=None):
    return orient_map.estimate_orientations(found, progress=progress or Progress())


def test_a_network_compares_the_photos_of_which_little_is_known(cfg, with_network):
    before = orient_map.newest(opened(cfg)).orientations
    assert not before.trust[:LITTLE_KNOWN].any()
    counted = Counting()
    found = thoroughly(with_network, counted)
    assert LITTLE_KNOWN <= counted.total == counted.done < len(before.trust)
    assert (found.indexed.extrinsics.trust[:LITTLE_KNOWN] >= MIN_TRUST).sum() >= LITTLE_KNOWN // 2
    assert np.median(headings_off(cfg, found)) < 5.0


def test_orientations_by_a_network_are_for_its_method_alone_and_made_once(cfg, with_network):
    plain = orient_map.newest(opened(cfg)).orientations
    found = thoroughly(with_network)
    assert (orient_map.newest(opened(cfg)).orientations.trust == plain.trust).all()
    counted, asked = Counting(), with_network.indexed.pair_matcher.asked
    again = thoroughly(with_network, counted)
    assert counted.total == 0
    assert with_network.indexed.pair_matcher.asked == asked
    assert (again.indexed.extrinsics.trust == found.indexed.extrinsics.trust).all()


def test_before_a_network_has_compared_anything_the_usual_orientations_serve(cfg, with_network):
    usual = orient_map.newest(opened(cfg)).orientations
    assert (orient_map.newest(with_network).orientations.trust == usual.trust).all()


def test_orientations_of_the_map_as_it_is_come_before_better_ones_of_what_it_was(cfg, with_network):
    thoroughly(with_network)
    lines = cfg.read_text().splitlines()
    first = lines[1].split(";")
    first[2] = str(int(first[2]) - 300)
    cfg.write_text("\n".join([lines[0], ";".join(first), *lines[2:]]) + "\n")
    usual = oriented(cfg).indexed.extrinsics
    now = opened(cfg)
    now = replace(now, indexed=replace(now.indexed, pair_matcher=with_network.indexed.pair_matcher))
    assert (orient_map.newest(now).orientations.trust == usual.trust).all()


def test_another_file_of_the_network_compares_again(with_network):
    thoroughly(with_network)
    with_network.indexed.pair_matcher.weights = "another"
    counted = Counting()
    thoroughly(with_network, counted)
    assert counted.total >= LITTLE_KNOWN


def test_what_is_known_in_the_maps_folder_counts_where_that_cannot_be_written(with_network, tmp_path):
    elsewhere = replace(with_network, writable=tmp_path / "elsewhere")
    counted = Counting()
    thoroughly(elsewhere, counted)
    assert counted.total == counted.done
    assert LITTLE_KNOWN <= counted.total < len(with_network.indexed.ids)
    assert {path.name for path in elsewhere.writable.iterdir()} == {
        "orientations-ivf-network.arrays",
        "pairs-ivf-network.arrays",
    }


def test_photos_of_the_same_content_have_the_same_orientation(cfg):
    found = oriented(cfg)
    contents = [*found.contents, found.contents[0]]
    stored = orient_map.newest(found)
    held = stored.orientations
    twice = replace(
        stored,
        contents=contents,
        position=np.vstack([stored.position, stored.position[:1]]),
        orientations=replace(
            held,
            rotation=np.concatenate([held.rotation, np.eye(3)[None]]),
            height=np.append(held.height, 0.0),
            trust=np.append(held.trust, 0.0),
        ),
    )
    again = orient_map.with_orientations(found, twice).indexed.extrinsics
    assert again.trust[0] == held.trust[0] > 0.0


def test_stopped_while_a_network_compares_it_continues(with_network, monkeypatch):
    monkeypatch.setattr(orient_map, "_SAVED_EVERY_S", 0.0)
    with pytest.raises(Cancelled):
        thoroughly(with_network, Counting(stop_after=4))
    rest = Counting()
    found = thoroughly(with_network, rest)
    weak = orient_map.newest(opened(with_network.cfg)).orientations.trust < orient_map._WELL_KNOWN
    assert rest.total == weak.sum() - 4 > 0
    assert found.indexed.extrinsics.trust.sum() > 0
