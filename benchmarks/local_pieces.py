"""Makes reconstructions of the photos round places of a map, from their positions and headings."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from webapp.core.features.types import Features
from webapp.core.geometry.extrinsics import MIN_TRUST
from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.core.landmarks.submodels import LEAST_PHOTOS, Submodel
from webapp.core.mapmodel.model import Experience
from webapp.files.landmarks.adjust import AdjustJob, adjust
from webapp.files.landmarks.cloud import CLOUD_FILE, StoredCloud, read_cloud, read_models, write_cloud
from webapp.files.landmarks.colmap import (
    SUBMODELS_FILE,
    Model,
    StoredSubmodels,
    read_submodels,
    write_submodels,
)
from webapp.files.landmarks.match_database import MatchDatabase
from webapp.progress import Progress
from webapp.settings import ExtractSettings
from webapp.tasks.computing.in_order import ExecutionTarget
from webapp.tasks.landmarks.adjust import Facts, positions_of
from webapp.tasks.landmarks.known import known_positions
from webapp.tasks.landmarks.on_demand import photos_around
from webapp.tasks.landmarks.reconstruct import compare_photos, describe_pictures
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.open_map import OpenMap

EXTRACT = ExtractSettings(max_side_px=1000, keypoints=2000)
"""Twice the keypoints of an index, half those of a reconstruction of the whole map."""

_INDEX_FROM_MAP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From the axes of an adjustment (right, down the image, into the ground) to those of a map's headings."""

At = tuple[float, float]


class Piece(NamedTuple):
    """A piece, and how far its adjusted cameras at its own place are off that place together, map pixels."""

    cloud: LandmarkCloud
    off_px: float  # NaN if none of them was joined


class _Photos(NamedTuple):
    """Photos of a piece that could be described."""

    experiences: list[Experience]
    contents: list[str]
    features: list[Features]


class PieceMaker:
    """Makes the pieces of a map, and keeps them by their photos.

    Args:
        opened: Opened with SIFT and with orientations; without panoramas.
        photos: Maximum number of photos of a piece.
    """

    def __init__(self, opened: OpenMap, work: Path, *, photos: int) -> None:
        self._opened, self._work, self._photos = opened, work, photos
        self._known = {e.id: e for e in opened.map.experiences}
        self._row = {id: row for row, id in enumerate(opened.indexed.ids.tolist())}
        pairs = orient_map.stored_pairs(opened)
        self._covisible = {*map(frozenset, zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))}

    def place_of(self, id: int) -> At:
        """Return the position of a photo."""
        return self._known[id].position

    def around(self, place: At) -> Piece:
        """Return the piece round a place; without points if its photos cannot be joined."""
        seeds = [e.id for e in self._known.values() if e.position == place]
        ids = sorted(photos_around(self._opened, seeds, count=self._photos))
        folder = self._work / hashlib.sha256(json.dumps(ids).encode()).hexdigest()[:16]
        joined, stored = read_submodels(folder / SUBMODELS_FILE), read_cloud(folder / CLOUD_FILE)
        if joined is None or stored is None:
            folder.mkdir(parents=True, exist_ok=True)
            joined, cloud = self._make([self._known[id] for id in ids], folder)
            write_submodels(folder / SUBMODELS_FILE, joined)
            write_cloud(folder / CLOUD_FILE, stored := StoredCloud(cloud, joined.cloud_key))
        own = {self._opened.contents[self._row[seed]] for seed in seeds}
        off = [
            centre[:2] - np.array(place)
            for submodel in joined.submodels
            for number, centre in zip(submodel.photo.tolist(), submodel.centre, strict=True)
            if joined.contents[number] in own
        ]
        return Piece(stored.cloud, float(np.hypot(*np.mean(off, axis=0))) if off else math.nan)

    def _make(self, some: Sequence[Experience], folder: Path) -> tuple[StoredSubmodels, LandmarkCloud]:
        photos = self._describe(some)
        database = MatchDatabase(folder / "matches.db")
        try:
            photos = self._match(photos, database)
        finally:
            database.close()
        model = self._adjust(photos, database.path, out=folder / "model")
        number = {content: n for n, content in enumerate(photos.contents)}
        submodels = []
        if model is not None:
            rows = np.array([number[content] for content in model.contents], np.int64)
            submodels = [Submodel(rows, model.centre, model.rotation)]
        joined = StoredSubmodels(tuple(submodels), tuple(photos.contents), folder.name)

        def described(content: str) -> tuple[Any, Any]:
            features = photos.features[number[content]]
            return features.xy, features.descriptors

        return joined, read_models([folder / "model"] if submodels else [], joined, described=described)

    def _describe(self, some: Sequence[Experience]) -> _Photos:
        opened, there = self._opened, replace(self._opened.map, experiences=tuple(some), unplaced=())
        found = describe_pictures(
            opened.cfg,
            there,
            folder=self._work,
            extract=EXTRACT,
            settings=opened.settings,
            progress=Progress(),
        )
        kept = [(one.photo, one.entry) for one in found.described if isinstance(one.photo, Experience)]
        return _Photos(
            [photo for photo, _ in kept],
            [entry.content for _, entry in kept],
            [entry.features for _, entry in kept],
        )

    def _match(self, photos: _Photos, database: MatchDatabase) -> _Photos:
        """Match the photos that the index has found to show the same scene; return those that were joined."""
        rows = [self._row[e.id] for e in photos.experiences]
        fovs = self._opened.indexed.fov_deg[rows].tolist()
        described = zip(photos.contents, photos.features, fovs, strict=True)
        stored = [
            (content, database.add(content, features, fov_deg=fov, is_guessed=False))
            for content, features, fov in described
        ]
        pairs = [
            pair
            for pair in combinations(range(len(rows)), 2)
            if frozenset(rows[n] for n in pair) in self._covisible
        ]
        compare_photos(
            database,
            stored,
            pairs=np.array(pairs, np.int64).reshape(-1, 2),
            network=None,
            place=ExecutionTarget(self._opened.settings, self._work),
            progress=Progress(),
        )
        joined = set(database.joined(photos.contents))
        kept = [n for n, content in enumerate(photos.contents) if content in joined]
        return _Photos(
            [photos.experiences[n] for n in kept],
            [photos.contents[n] for n in kept],
            [photos.features[n] for n in kept],
        )

    def _adjust(self, photos: _Photos, database: Path, *, out: Path) -> Model | None:
        indexed = self._opened.indexed
        known = known_positions(photos.experiences, self._opened.map)
        count = len(photos.contents)
        turn_deg = np.zeros(count, np.int64)
        positions = positions_of(photos.contents, Facts(known), photo=np.arange(count), turn_deg=turn_deg)
        rows = np.array([self._row[e.id] for e in photos.experiences])
        if indexed.extrinsics is None:
            return None
        start = np.flatnonzero(indexed.extrinsics.trust[rows] >= MIN_TRUST)
        if len(start) < LEAST_PHOTOS:
            return None
        at = np.column_stack([known.at.real, known.at.imag, np.zeros(count)])
        rotation = indexed.extrinsics.rotation[rows] @ _INDEX_FROM_MAP
        contents = tuple(photos.contents[n] for n in start)
        return adjust(AdjustJob(database, (), out, contents, at[start], rotation[start], positions))
