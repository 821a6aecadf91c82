"""Extrinsics of the photos of a map, and depths of their keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MIN_TRUST = 0.5
"""Minimum sum of the trust in agreeing pairs for an orientation to be used."""


@dataclass(frozen=True, slots=True, eq=False)
class KeypointDepths:
    """Depths of d keypoints along their photos' viewing directions."""

    photo: NDArray[np.int32]  # (d,) int32. Ascending.
    row: NDArray[np.int32]  # (d,) int32. Number of the keypoint in the photo, ascending within it.
    inverse_depth: NDArray[np.float32]  # (d,) float32. One over the depth, per map pixel.
    sigma: NDArray[np.float32]  # (d,) float32. Standard deviation of `inverse_depth`.

    def lookup(self, photo: int, row: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Look up inverse depths of a photo's keypoints (m,) and their sigmas (m,); NaN where unknown."""
        first, stop = np.searchsorted(self.photo, [photo, photo + 1])
        inverse, spread = np.full((2, len(row)), np.nan)
        if first == stop:
            return inverse, spread
        at = first + np.minimum(np.searchsorted(self.row[first:stop], row), stop - first - 1)
        known = self.row[at] == row
        inverse[known], spread[known] = self.inverse_depth[at[known]], self.sigma[at[known]]
        return inverse, spread

    def renumbered(self, number: NDArray[np.int64]) -> KeypointDepths:
        """Renumber photos by their new numbers (p,), and leave out those whose number is -1."""
        left = np.flatnonzero(number[self.photo] >= 0)
        photo = number[self.photo[left]]
        if np.array_equal(photo, self.photo):
            return self
        if (np.diff(photo) < 0).any():
            order = np.argsort(photo, kind="stable")
            left, photo = left[order], photo[order]
        return KeypointDepths(
            photo.astype(np.int32), self.row[left], self.inverse_depth[left], self.sigma[left]
        )


def empty_depths() -> KeypointDepths:
    rows, values = np.zeros(0, np.int32), np.zeros(0, np.float32)
    return KeypointDepths(rows, rows, values, values)


@dataclass(frozen=True, slots=True, eq=False)
class MapExtrinsics:
    """Extrinsics of p photos, and depths of their keypoints."""

    rotation: NDArray[np.float64]  # (p, 3, 3) float64. Camera from world.
    height: NDArray[np.float64]  # (p,) float64. Downwards, relative to the other photos, map pixels.
    # (p,) float64. Sum of the trust in the pairs that agree with the rotation; 0 if it is unknown.
    trust: NDArray[np.float64]
    depths: KeypointDepths  # Depths of keypoints that several photos see
    # (p,) int64. For each photo that certainly shows the same scene as another, the number of the one with
    # which it shares most inliers; -1 for the rest, and by default for all.
    partner: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if len(self.partner) != len(self.trust):
            object.__setattr__(self, "partner", np.full(len(self.trust), -1, np.int64))

    def centres(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cameras' centres in the world (p, 3), from their positions on the map (p, 2)."""
        return np.column_stack([position[:, 0], self.height, -position[:, 1]])
