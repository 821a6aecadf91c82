"""Which photos to place next: those that bring most of the others onto the map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from webapp.core.landmarks.placing import AlignedSubmodel, KnownPositions, NotAligned
from webapp.core.landmarks.submodels import Submodel


def propose_next(
    submodels: Sequence[Submodel],
    aligned: Sequence[AlignedSubmodel | NotAligned],
    *,
    known: KnownPositions,
    most: int,
) -> list[int]:
    """Propose photos to place, the most useful first.

    Submodels that are not on the map yet come first, the largest first: each needs two photos, far apart.
    Then comes the most uncertain photo of each submodel that is on the map.

    Returns:
        Numbers of photos.
    """
    placed = np.isfinite(known.at)
    missing: list[int] = []
    for submodel, result in zip(submodels, aligned, strict=True):
        if isinstance(result, NotAligned):
            missing += _far_apart(submodel, placed[submodel.photo])
    unsure = [
        (float(radius), int(photo))
        for submodel, result in zip(submodels, aligned, strict=True)
        if isinstance(result, AlignedSubmodel)
        for photo, radius in [_least_certain(submodel, result, placed[submodel.photo])]
        if photo >= 0
    ]
    return [*missing, *(photo for _, photo in sorted(unsure, reverse=True))][:most]


def _far_apart(submodel: Submodel, placed: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    """Choose the two photos that are farthest apart, or the one farthest from those that are placed."""
    apart = np.linalg.norm(submodel.centre[:, None] - submodel.centre, axis=2)
    if not placed.any():
        return [int(n) for n in submodel.photo[list(np.unravel_index(apart.argmax(), apart.shape))]]
    away = np.where(placed, -1.0, apart[:, placed].min(1))
    return [int(submodel.photo[away.argmax()])] if away.max() > 0.0 else []


def _least_certain(
    submodel: Submodel, aligned: AlignedSubmodel, placed: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> tuple[int, float]:
    radius = np.where(placed, -1.0, aligned.radius_px)
    row = int(radius.argmax())
    return (int(submodel.photo[row]), float(radius[row])) if radius[row] >= 0.0 else (-1, 0.0)
