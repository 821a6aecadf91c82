"""Which photos to place next: those that bring most of the others onto the map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from webapp.core.landmarks.pieces import RigidPiece
from webapp.core.landmarks.placing import KnownPositions, LaidPiece, NotLaid


def propose_next(
    pieces: Sequence[RigidPiece], laid: Sequence[LaidPiece | NotLaid], *, known: KnownPositions, most: int
) -> list[int]:
    """Propose photos to place, the most useful first.

    Pieces that are not on the map yet come first, the largest first: each needs two photos, far apart.
    Then come photos of which it is least certain where they are.

    Returns
    -------
    list of int
        Numbers of photos.
    """
    placed = np.isfinite(known.at)
    missing: list[int] = []
    for piece, result in zip(pieces, laid, strict=True):
        if isinstance(result, NotLaid):
            missing += _far_apart(piece, placed[piece.photo])
    unsure = [
        (float(radius), int(photo))
        for piece, result in zip(pieces, laid, strict=True)
        if isinstance(result, LaidPiece)
        for photo, radius in [_least_certain(piece, result, placed[piece.photo])]
        if photo >= 0
    ]
    return [*missing, *(photo for _, photo in sorted(unsure, reverse=True))][:most]


def _far_apart(piece: RigidPiece, placed: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    """Choose the photos by which a piece would have two that are far apart; one more where it has two."""
    apart = np.linalg.norm(piece.centre[:, None] - piece.centre, axis=2)
    if not placed.any():
        return [int(n) for n in piece.photo[list(np.unravel_index(apart.argmax(), apart.shape))]]
    away = np.where(placed, -1.0, apart[:, placed].min(1))
    return [int(piece.photo[away.argmax()])] if away.max() > 0.0 else []


def _least_certain(
    piece: RigidPiece, laid: LaidPiece, placed: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> tuple[int, float]:
    radius = np.where(placed, -1.0, laid.radius_px)
    row = int(radius.argmax())
    return (int(piece.photo[row]), float(radius[row])) if radius[row] >= 0.0 else (-1, 0.0)
