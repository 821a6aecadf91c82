"""Checks in seconds into which pieces the photos of a map fall, and between which ones photos are missing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import Camera, relative_pose
from webapp.core.landmarks.matching import match_mutually, rank_pairs
from webapp.core.landmarks.pieces import LEAST_INLIERS, Overlap, PhotoPieces, PieceGraph
from webapp.core.retrieval.fields_of_view import guessed_fov_deg
from webapp.errors import StorageError
from webapp.files.atomic import make_folder, read_bytes, write_text
from webapp.files.listing import DERIVED
from webapp.files.lock import writer_lock
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.landmarks.reconstruct import DescribedPicture, describe_pictures, known_fov_deg
from webapp.tasks.localize.index_location import landmarks_folder

STORED = "photo-pieces.json"
"""File of the latest report of a map."""

_FOLDER, _FILE, _VERSION = "pieces", "pairs.json", 1

_EXTRACT = ExtractSettings(max_side_px=500, keypoints=800)
"""Small photos: enough to see whether two overlap, in a tenth of the time of a reconstruction."""

Counts = dict[str, tuple[int, int]]
"""Matches and inliers of the pairs compared so far, by the content hashes of the two pictures."""


@dataclass(frozen=True, slots=True)
class PhotoGap:
    """Where photos are missing: between a photo of one piece, and one of another."""

    photo: int  # Id
    other: int  # Id of the photo that shows most of the same, or else was taken next
    matches: int  # Verified matches of the two; 0 if they show nothing in common


@dataclass(frozen=True, slots=True)
class PiecesReport:
    """The pieces into which the photos of a map fall; all photos by their ids."""

    revision: int  # Of the map
    names: Mapping[int, str]  # Paths of all photos
    pieces: tuple[tuple[int, ...], ...]  # The largest first
    alone: tuple[int, ...]  # Photos that cannot be joined with any other
    bridges: tuple[int, ...]  # Photos of a piece that show the same as a photo outside, but as one only
    # Where photos between two would join more: for each piece but the largest, then for the photos alone
    gaps: tuple[PhotoGap, ...]
    place_next: tuple[int, ...]  # Photos to place by hand first: two of each piece, far from each other
    failed: Mapping[int, str]  # Why photos could not be read


def check_pieces(cfg: Path, *, settings: Settings, progress: Progress) -> PiecesReport:
    """Estimate which photos of a map can be joined, those in the tray included; nothing is changed.

    What was described and compared is kept: further runs take only new photos.

    Raises:
        MapError: The map cannot be read.
        FolderInUse: Another process checks the photos of this map.
    """
    the_map = read_map(cfg)
    folder = landmarks_folder(cfg) / _FOLDER
    with writer_lock(folder):
        pictures = describe_pictures(
            cfg, the_map, folder=folder, extract=_EXTRACT, settings=settings, progress=progress
        )
        counts = _read(folder / _FILE)
        before = len(counts)
        try:
            found = _compare_all(
                pictures.described,
                counts,
                ranks=rank_pairs(
                    [one.entry.features.descriptors for one in pictures.described], views=pictures.views
                ),
                place=ExecutionTarget(replace(settings, dask=None), folder, "threads"),
                progress=progress,
            )
        finally:
            if len(counts) > before:
                write_text(folder / _FILE, json.dumps({"version": _VERSION, "pairs": counts}))
    ids = [photo.id for photo in pictures.photos]
    there = sorted({one.number for one in pictures.described})
    return PiecesReport(
        the_map.revision,
        {photo.id: photo.photo for photo in pictures.photos},
        tuple(tuple(ids[there[n]] for n in piece) for piece in found.pieces),
        tuple(ids[there[n]] for n in found.alone),
        tuple(ids[there[n]] for n in found.bridges),
        tuple(PhotoGap(ids[there[gap.one]], ids[there[gap.other]], gap.inliers) for gap in found.gaps),
        tuple(ids[there[n]] for n in found.place_first),
        {ids[n]: reason for n, reason in pictures.problems.items()},
    )


class _Compared:
    """Pictures whose pairs are compared; threads share them."""

    def __init__(self, pictures: Sequence[DescribedPicture]) -> None:
        self._features = [one.entry.features for one in pictures]
        self._cameras = [_camera(one) for one in pictures]

    def compare(self, pair: tuple[int, int]) -> tuple[int, int]:
        """Count the matches of a pair, and those that agree on a relative pose."""
        one, other = (self._features[n] for n in pair)
        rows = match_mutually(one.descriptors, other.descriptors)
        if len(rows) < LEAST_INLIERS:
            return len(rows), 0
        query, photo = (self._cameras[n] for n in pair)
        pose = relative_pose(one.xy[rows[:, 0]], other.xy[rows[:, 1]], query=query, photo=photo)
        return len(rows), 0 if isinstance(pose, NoPose) else pose.inliers


def _camera(one: DescribedPicture) -> Camera:
    size = one.entry.features.photo_size
    return Camera(*size, known_fov_deg(one.photo, one.entry) or guessed_fov_deg(*size))


def _compare(compared: _Compared, pair: tuple[int, int]) -> tuple[int, int]:
    return compared.compare(pair)


def _compare_all(
    pictures: Sequence[DescribedPicture],
    counts: Counts,
    *,
    ranks: Sequence[Sequence[tuple[int, int]]],
    place: ExecutionTarget,
    progress: Progress,
) -> PhotoPieces:
    """Compare pairs, the most promising first, except where their photos are joined already."""
    numbers = np.unique([one.number for one in pictures], return_inverse=True)[1].tolist()
    graph, compared = PieceGraph(len(set(numbers))), _Compared(pictures)
    progress.note("comparing the photos")
    progress.size(sum(map(len, ranks)))
    for rank in ranks:
        open_pairs = [pair for pair in rank if not graph.is_joined(*(numbers[n] for n in pair))]
        keys = [":".join(sorted(pictures[n].entry.content for n in pair)) for pair in open_pairs]
        new = {key: pair for key, pair in zip(keys, open_pairs, strict=True) if key not in counts}
        progress.skip(len(rank) - len(new))
        found = in_order(_compare, new.values(), shared=compared, at=place, progress=progress)
        for key, result in zip(new, found, strict=True):
            counts[key] = result
            progress.advance()
        for key, pair in zip(keys, open_pairs, strict=True):
            one, other = sorted(numbers[n] for n in pair)
            graph.add(Overlap(one, other, *counts[key]))
    return graph.result()


def _read(path: Path) -> Counts:
    """Read the pairs compared earlier; none if the file is missing, damaged or of another version."""
    try:
        content: dict[str, Any] = json.loads(read_bytes(path))
        if content["version"] == _VERSION:
            return {key: (int(matches), int(inliers)) for key, (matches, inliers) in content["pairs"].items()}
    except (StorageError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return {}


def as_json(report: PiecesReport) -> dict[str, Any]:
    """Convert a report to JSON values, documented in `docs/results.md`."""
    return {
        "revision": report.revision,
        "pieces": [list(piece) for piece in report.pieces],
        "alone": list(report.alone),
        "bridges": list(report.bridges),
        "gaps": [{"photo": gap.photo, "other": gap.other, "matches": gap.matches} for gap in report.gaps],
        "place_next": list(report.place_next),
        "failed": [{"id": id, "reason": reason} for id, reason in report.failed.items()],
    }


def keep(cfg: Path, report: PiecesReport) -> None:
    """Store a report for the page of the map. Raises StorageError."""
    path = cfg.parent / DERIVED / STORED
    make_folder(path.parent)
    write_text(path, json.dumps({"version": _VERSION, **as_json(report)}))


def read(cfg: Path) -> dict[str, Any] | None:
    """Read the stored report; None if there is none of this version. Raises StorageError."""
    try:
        content: dict[str, Any] = json.loads((cfg.parent / DERIVED / STORED).read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StorageError(
            "the pieces cannot be read", where=STORED, hint="check the photos again"
        ) from error
    return content if content.get("version") == _VERSION else None
