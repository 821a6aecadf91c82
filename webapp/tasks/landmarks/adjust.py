"""Adjusts the pieces of a reconstruction by the known positions of their photos."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from webapp.core.landmarks.pieces import RigidPiece
from webapp.core.landmarks.placing import KnownPositions, LaidPiece, PlanTransform, lay_piece
from webapp.core.mapmodel.model import Map
from webapp.errors import IndexDamaged
from webapp.files.landmarks.adjust import AdjustJob
from webapp.files.landmarks.colmap import (
    PIECES_FILE,
    read_pieces,
    split_models,
    write_pieces,
)
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.tasks.landmarks.known import known_positions
from webapp.tasks.landmarks.mapping import ADJUSTED, model_folders, run_adjustment
from webapp.tasks.landmarks.reconstruct import Reconstruction, keep_cloud, renumbered

_LEAST_KNOWN = 4
"""Positions by which a piece is adjusted: with three nothing would say that one of them is wrong."""

_LEAST_WIDE = 0.05
"""Spread of the known positions across over that along, below which they are in a line."""

_HEIGHT_SHARE = 0.1
"""Standard deviation of a camera's height, which no map says, over the extent of the known positions."""


@dataclass(frozen=True, slots=True)
class AdjustedPiece:
    """What came of a piece.

    Attributes
    ----------
    photos : tuple of int
        Numbers of its photos.
    problem : str
        Why it is as it was; empty where it was adjusted.
    residual_px : mapping of int to float
        Distance of the adjusted cameras from the known positions, also of those that were left out, by the
        photos' numbers.
    """

    photos: tuple[int, ...]
    problem: str
    residual_px: Mapping[int, float]


def adjust_pieces(
    found: Reconstruction, the_map: Map, *, progress: Progress
) -> tuple[Reconstruction, list[AdjustedPiece]]:
    """Adjust pieces by the placed photos and by those with GPS, each as exactly as it is known.

    Placed photos that contradict the others are left out. A piece with too few of them, or with all in a
    line, stays as it is, as does one that would not agree with its photos any more.

    Raises
    ------
    IndexDamaged
        The reconstruction is gone from the disk.
    StorageError, ProcessLost, Cancelled
    """
    with writer_lock(found.folder):
        stored = read_pieces(found.folder / PIECES_FILE)
        if stored is None:
            raise IndexDamaged("the pieces are gone", where=str(found.folder), hint="run it again")
        photos = [found.photos[found.number_of[content]] for content in stored.contents]
        known = known_positions(photos, the_map)
        state = _state(known)
        pieces: list[RigidPiece] = list(stored.pieces)
        report: list[AdjustedPiece] = []
        shutil.rmtree(found.folder / ADJUSTED, ignore_errors=True)
        progress.note("adjusting them by the placed photos")
        for number, (folder, piece) in enumerate(split_models(model_folders(found.folder), stored)):
            pieces[number], problem = _adjusted(
                piece,
                known,
                folders=(folder, found.folder / ADJUSTED / str(number)),
                contents=stored.contents,
                progress=progress,
            )
            photos_of = (found.number_of[stored.contents[n]] for n in piece.photo.tolist())
            numbers = tuple(dict.fromkeys(photos_of))
            off = {} if problem else _residuals(pieces[number], known)
            residual = {found.number_of[stored.contents[n]]: value for n, value in off.items()}
            report.append(AdjustedPiece(numbers, problem, residual))
        stored = replace(stored, pieces=tuple(pieces), adjusted=state)
        write_pieces(found.folder / PIECES_FILE, stored)
        keep_cloud(found.folder, stored)
    return replace(found, pieces=tuple(renumbered(stored, found.number_of, turn_of=found.turn_of))), report


def _state(known: KnownPositions) -> str:
    """Stand for known positions and how exact they are."""
    rows = np.column_stack([known.at.real, known.at.imag, known.sigma_px]).round(3).tolist()
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()[:16]


def _residuals(piece: RigidPiece, known: KnownPositions) -> dict[int, float]:
    """Compare the cameras of an adjusted piece, whose world is the map's, with what is known of them."""
    at = known.at[piece.photo]
    off = np.abs(piece.centre[:, 0] + 1j * piece.centre[:, 1] - at)
    there = zip(piece.photo.tolist(), off.tolist(), strict=True)
    return {number: distance for number, distance in there if not math.isnan(distance)}


def _adjusted(
    piece: RigidPiece,
    known: KnownPositions,
    *,
    folders: tuple[Path, Path],
    contents: tuple[str, ...],
    progress: Progress,
) -> tuple[RigidPiece, str]:
    """Adjust a piece; returns it as it was with the reason where that cannot be.

    Parameters
    ----------
    folders : (Path, Path)
        Of the model that holds it, and for the adjusted piece.
    contents : tuple of str
        Of the photos of all pieces.
    """
    laid = lay_piece(piece, known)
    if not isinstance(laid, LaidPiece):
        return piece, laid.reason
    transform = laid.transform
    problem = _too_little(transform)
    if problem:
        return piece, problem
    names = tuple(contents[number] for number in piece.photo.tolist())
    model = run_adjustment(_job(piece, transform, folders=folders, names=names), progress=progress)
    if model is None or set(model.contents) != set(names):
        shutil.rmtree(folders[1], ignore_errors=True)
        return piece, "its photos do not agree with the positions"
    row = [model.contents.index(name) for name in names]
    return RigidPiece(piece.photo, model.centre[row], model.rotation[row], transform.error_rate), ""


def _job(
    piece: RigidPiece, transform: PlanTransform, *, folders: tuple[Path, Path], names: tuple[str, ...]
) -> AdjustJob:
    similarity = transform.similarity()
    height = similarity.apply(piece.centre[transform.row])[:, 2]
    at = np.column_stack([transform.at.real, transform.at.imag, height])
    free = _HEIGHT_SHARE * float(np.ptp(at[:, :2], axis=0).max())
    sigma = np.column_stack([transform.sigma_px, transform.sigma_px, np.full(len(at), free)])
    known = tuple(names[row] for row in transform.row.tolist())
    return AdjustJob(*folders, names, similarity, known, at, sigma)


def _too_little(transform: PlanTransform) -> str:
    """Say what known positions lack to adjust a piece by them."""
    if len(transform.at) < _LEAST_KNOWN:
        return f"{len(transform.at)} of its photos are placed, {_LEAST_KNOWN} are needed"
    off = transform.at - transform.at.mean()
    along, across = np.linalg.svd(np.column_stack([off.real, off.imag]), compute_uv=False)
    return "its placed photos are in a line" if across < _LEAST_WIDE * along else ""
