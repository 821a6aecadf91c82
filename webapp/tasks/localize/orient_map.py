"""Estimates orientations of a map's photos and depths of their keypoints; stores them next to the index."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.table import PAIR_MATCHERS
from webapp.core.geometry.extrinsics import MapExtrinsics
from webapp.core.hypotheses.places import MapPlaces, PhotoGroups, describe_places
from webapp.core.mapmodel.panorama import experiences_of
from webapp.core.reconstruction.depths import DepthObservations, triangulate_depths
from webapp.core.reconstruction.orientation import estimate_extrinsics
from webapp.core.reconstruction.pairs import (
    PhotoPairs,
    best_of_each_pair,
    concatenate,
    match_photo,
    strongest_partners,
)
from webapp.core.retrieval.indexed import IndexedMap
from webapp.files.localize import orientations
from webapp.files.localize.orientations import StoredOrientations, StoredPairs
from webapp.progress import Progress
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.localize.open_index import MapSource, RebuiltValue
from webapp.tasks.localize.open_map import OpenMap

_SAVED_EVERY_S = 20.0
_MOVED = 0.5
"""A photo that was moved farther than this, in place radii, loses its orientation."""


_WELL_KNOWN = 2.0
"""Trust (summed over pairs) from which on matching a photo with a network adds little."""


def estimate_orientations(opened: OpenMap, *, progress: Progress) -> OpenMap:
    """Update the orientations of a map's photos and attach them to it.

    If the method matches with a network, all photos with little trust are compared again with it, which takes
    about a second each on two cores.
    The pairs found are stored: only new photos are compared with the others, and a moved photo merely repeats
    the last, quick step. A killed run is resumed.

    Args:
        opened: Opened for a method that verifies geometry.
        progress: One stage of comparisons, with a network a second one; one step per new photo.

    Raises:
        InputError: onnxruntime cannot run the network file that the user supplied.
        StorageError, Cancelled
    """
    key = f"{opened.map_hash} {opened.plan.map_fov_deg}"
    usual, again = _comparisons(opened)
    everyone = range(len(opened.indexed.ids))
    files = _usual_paths(opened)
    stored = _up_to_date(
        opened, files, key=key, progress=progress, compare=lambda: usual.run(everyone, progress)
    )
    if again is not None:
        little = np.flatnonzero(stored.orientations.trust < _WELL_KNOWN).tolist()
        stored = _up_to_date(
            opened,
            _own_paths(opened),
            key=f"{key} {again.weights}",
            progress=progress,
            compare=lambda: best_of_each_pair(
                concatenate([usual.run(everyone, progress, stage=False), again.run(little, progress)])
            ),
        )
    return with_orientations(opened, stored)


def sightings(opened: OpenMap) -> DepthObservations | None:
    """Triangulate depths from each stored pair of a map's photos; None for a map without orientations.

    Raises StorageError.
    """
    known = opened.indexed.extrinsics
    if known is None:
        return None
    pairs = stored_pairs(opened)
    indexed = opened.indexed
    return triangulate_depths(
        pairs,
        indexed.position,
        extrinsics=known,
        ray_sigma=indexed.ray_sigmas(indexed.tuning.extrinsics.keypoint_sigma_px),
        place_radius_px=indexed.place_radius_px,
        tuning=indexed.tuning.extrinsics,
    )


def stored_pairs(opened: OpenMap) -> PhotoPairs:
    """Read the stored pairs of a map's photos. Raises StorageError."""
    return best_of_each_pair(concatenate([c.known().pairs for c in _comparisons(opened) if c is not None]))


def estimate(indexed: IndexedMap, pairs: PhotoPairs) -> MapExtrinsics:
    """Estimate the extrinsics of a map from its pairs, with its own tuning."""
    tuning = indexed.tuning.extrinsics
    found = estimate_extrinsics(
        pairs,
        indexed.position,
        ray_sigma=indexed.ray_sigmas(tuning.keypoint_sigma_px),
        place_radius_px=indexed.place_radius_px,
        tuning=tuning,
    )
    return replace(found, partner=_partners(indexed, pairs))


def _partners(indexed: IndexedMap, pairs: PhotoPairs) -> NDArray[np.int64]:
    least = indexed.tuning.extrinsics.certain_inliers
    return strongest_partners(pairs, photos=len(indexed.ids), inliers=least)


def _comparisons(opened: OpenMap) -> tuple[_Comparison, _Comparison | None]:
    """Return the usual comparison of photos, and the one by the method's network, if it has one."""
    usual = _Comparison(opened, opened.choice.matcher, None)
    network = opened.indexed.pair_matcher
    if network is None or opened.method != "thorough":
        return usual, None
    return usual, _Comparison(opened, _with_network(opened), network)


def _up_to_date(
    opened: OpenMap,
    files: tuple[Path, Path],
    *,
    key: str,
    progress: Progress,
    compare: Callable[[], PhotoPairs],
) -> StoredOrientations:
    """Read the orientations with this key from one of the files, or estimate and write them."""
    known = next((k for k in _stored(files) if k.key == key), None)
    if known is not None:
        progress.size(0)
        return known
    pairs = compare()
    progress.note("estimating the orientations of the photos")
    places = _describe(opened, trust=None, partner=_partners(opened.indexed, pairs))
    found = estimate(replace(opened.indexed, place_radius_px=places.radius_px), pairs)
    stored = StoredOrientations(found, opened.contents, opened.indexed.position, key)
    orientations.write(files[-1], stored)
    return stored


def paths(opened: OpenMap) -> tuple[Path, ...]:
    """Return the possible files of a map's orientations, the best last; the last one is written."""
    usual, own = _usual_paths(opened), _own_paths(opened)
    return own if own == usual else (*usual, *own)


def newest(opened: OpenMap) -> StoredOrientations | None:
    """Read the best stored orientations, preferably of the map's current state; None if there are none."""
    known = _stored(paths(opened))
    return next((k for k in known if k.key.startswith(opened.map_hash)), known[0] if known else None)


def _usual_paths(opened: OpenMap) -> tuple[Path, Path]:
    return opened.artifact_paths(f"orientations-{opened.choice.matcher}.arrays")


def _own_paths(opened: OpenMap) -> tuple[Path, Path]:
    """Return the files of the orientations that are estimated for the map's method."""
    if opened.method != "thorough":
        return _usual_paths(opened)
    return opened.artifact_paths(f"orientations-{_with_network(opened)}.arrays")


def _stored(files: tuple[Path, ...]) -> list[StoredOrientations]:
    """Read the files that exist and are valid, the last one first."""
    return [k for path in reversed(files) if (k := orientations.read(path)) is not None]


def _with_network(opened: OpenMap) -> str:
    return f"{opened.choice.matcher}-{PAIR_MATCHERS[opened.choice.name]}"


def with_orientations(opened: OpenMap, stored: StoredOrientations | None) -> OpenMap:
    """Attach stored orientations to an open map, for the photos that have not been moved far since."""
    if stored is None:
        return opened
    indexed = opened.indexed
    number = _numbers(stored.contents)
    row = np.array([number.get(content, -1) for content in opened.contents], np.int64)
    moved = np.hypot(*(indexed.position - stored.position[row]).T)
    known = (row >= 0) & (moved <= _MOVED * indexed.place_radius_px)
    there = stored.orientations
    # Of several photos with equal content, the index and the pairs refer to the first.
    first = _numbers(opened.contents)
    now = np.array([i if known[i := first.get(c, -1)] else -1 for c in stored.contents], np.int64)
    found = MapExtrinsics(
        rotation=there.rotation[row],
        height=there.height[row],
        trust=np.where(known, there.trust[row], 0.0),
        depths=there.depths.renumbered(now),
        partner=np.where(known & (there.partner[row] >= 0), now[there.partner[row]], -1),
    )
    return _with_extrinsics(opened, found)


def _with_extrinsics(opened: OpenMap, extrinsics: MapExtrinsics) -> OpenMap:
    """Attach extrinsics to an open map and derive the kind of map; photos in areas get no trust."""
    indexed = opened.indexed
    places = _describe(opened, trust=extrinsics.trust, partner=extrinsics.partner)
    trust = np.where(places.area < 0, extrinsics.trust, 0.0)
    indexed = replace(
        indexed,
        extrinsics=replace(extrinsics, trust=trust),
        kind=places.kind,
        area=places.area,
        place_radius_px=places.radius_px,
    )
    return replace(opened, indexed=indexed)


def _describe(opened: OpenMap, *, trust: NDArray[np.float64] | None, partner: NDArray[np.int64]) -> MapPlaces:
    """Determine the kind of map and its place radius, unless the user states them."""
    size, plan = opened.map.satellite, opened.plan
    places = describe_places(
        opened.indexed.position,
        trust=trust,
        size=(size.width, size.height),
        kind=plan.map_kind,
        partner=partner,
        groups=PhotoGroups(experiences_of(opened.indexed.ids), opened.indexed.floor),
    )
    return replace(places, radius_px=plan.right_within_px or places.radius_px)


class _Known(NamedTuple):
    """Pairs with photo numbers of the map, and the content hashes of the photos that have been compared."""

    pairs: PhotoPairs
    done: set[str]


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """How photos of a map are compared with each other."""

    opened: OpenMap
    name: str  # Name of the matcher, used in the file name
    matcher: PairMatcher | None

    @property
    def weights(self) -> str:
        """Identifies the network's weights; empty without a network."""
        return self.matcher.weights if self.matcher else ""

    @property
    def _key(self) -> str:
        return f"{self.name} {self.opened.plan.map_fov_deg} {self.weights}".strip()

    @property
    def _files(self) -> tuple[Path, Path]:
        return self.opened.artifact_paths(f"pairs-{self.name}.arrays")

    def known(self) -> _Known:
        """Read the stored pairs whose photos are both still in the map."""
        there = (orientations.read_pairs(path) for path in reversed(self._files))
        stored = next((k for k in there if k is not None and k.key == self._key), None)
        if stored is None:
            return _Known(concatenate([]), set())
        number = _numbers(self.opened.contents)
        now: NDArray[np.int64] = np.array([number.get(c, -1) for c in stored.contents], np.int64)
        first, second = now[stored.pairs.first], now[stored.pairs.second]
        which = np.flatnonzero((first >= 0) & (second >= 0))
        pairs = stored.pairs.subset(which, first=first[which], second=second[which])
        return _Known(pairs, set(stored.contents[: stored.done]))

    def run(self, photos: Iterable[int], progress: Progress, *, stage: bool = True) -> PhotoPairs:
        """Compare those of the given photos that have not been compared; return all known pairs.

        Without `stage`, `progress.size` is not called.
        """
        contents = self.opened.contents
        number = _numbers(contents)
        known, done = self.known()
        parts = [known]
        todo = [i for i in photos if number.get(contents[i]) == i and contents[i] not in done]
        if todo:
            progress.note(
                "comparing the map's photos with each other"
                if self.matcher is None
                else "matching the map's photos with a network"
            )
        if stage:
            progress.size(len(todo))
        saved = time.monotonic()
        for photo, found in zip(todo, self._compare(todo, progress), strict=True):
            parts.append(found)
            done.add(contents[photo])
            progress.advance()
            if photo == todo[-1] or time.monotonic() > saved + _SAVED_EVERY_S:
                parts = [concatenate(parts)]
                _store(self._files[-1], parts[0], contents=contents, done=done, key=self._key)
                saved = time.monotonic()
        return concatenate(parts)

    def _compare(self, photos: Sequence[int], progress: Progress) -> Iterator[PhotoPairs]:
        opened, by_network = self.opened, self.matcher is not None
        again = RebuiltValue(
            partial(_open_again, MapSource.of(opened), by_network), _Compared(opened.indexed, self.matcher)
        )
        at = ExecutionTarget(opened.settings, opened.writable, "threads")
        return in_order(_match, photos, shared=again, at=at, progress=progress)


class _Compared(NamedTuple):
    """A map whose photos are compared with each other, by a network or without one."""

    indexed: IndexedMap
    matcher: PairMatcher | None


def _open_again(files: MapSource, by_network: bool) -> _Compared:
    indexed = files.open().indexed
    return _Compared(indexed, indexed.pair_matcher if by_network else None)


def _match(compared: RebuiltValue[_Compared], photo: int) -> PhotoPairs:
    indexed, matcher = compared.value()
    return match_photo(indexed, photo, matcher=matcher)


def _numbers(contents: list[str]) -> dict[str, int]:
    """Map content hashes to photo numbers; of several equal photos the first is used."""
    return {content: i for i, content in reversed([*enumerate(contents)]) if content}


def _store(path: Path, pairs: PhotoPairs, *, contents: list[str], done: set[str], key: str) -> None:
    """Write pairs with the content hashes of their photos, those that have been compared first."""
    ordered = sorted({c for c in contents if c}, key=lambda c: c not in done)
    place = {c: i for i, c in enumerate(ordered)}
    number = np.array([place.get(c, -1) for c in contents], np.int64)
    every = np.arange(len(pairs))
    stored = pairs.subset(every, first=number[pairs.first], second=number[pairs.second])
    count = sum(c in done for c in ordered)
    orientations.write_pairs(path, StoredPairs(stored, ordered, count, key))
