"""Evidence for a place: the votes for the photos around it, their verified geometry, and their similarity by
global descriptors.

Votes are squared, so that many weak ones do not add up to a place. The share of them around a place means
little by itself: on a small map many are close together by chance. It is therefore compared with the share of
the best place if the same votes were cast for photos drawn at random (a permutation test).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.hypotheses.calibration import EVIDENCE
from webapp.core.retrieval.indexed import IndexedMap

Array = NDArray[np.float64]

_DRAWS = 16
_SEED = 0
_NO_SHARE = 1e-3
"""Added to shares of the votes and minimum of those by chance, so that logarithms are finite."""

_AGREED_SCALE, _TRUST_SCALE = 20.0, 5.0
"""Factors on score and trust, which count photos, in log(1 + factor * x)."""


@dataclass(frozen=True, slots=True, eq=False)
class Voters:
    """The photos with most votes."""

    photo: NDArray[np.int64]  # (n,) int64. Their numbers, most votes first.
    votes: Array  # (n,) float64
    trust: Array  # (n,) float64. Trust in the relative pose to the query, 0 to 1; 0 if not verified.

    def with_votes(self) -> Voters:
        """Leave out photos without votes, which were shortlisted for other reasons."""
        some = self.votes > 0.0
        return Voters(self.photo[some], self.votes[some], self.trust[some])


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """n points on the map that are compared as places."""

    position: Array  # (n, 2) float64. Map pixels.
    area: NDArray[np.int64]  # (n,) int64. The number of an area, or -1.
    # (n,) int64. Ids of their floors; by default all are on one.
    floor: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if len(self.floor) != len(self.area):
            object.__setattr__(self, "floor", np.full(len(self.area), BASE_FLOOR, np.int64))


def photo_spots(indexed: IndexedMap, photo: NDArray[np.int64]) -> Spots:
    return Spots(indexed.position[photo], indexed.area[photo], indexed.floor[photo])


def nearness(first: Spots, second: Spots, *, reach_px: float) -> Array:
    """Compute the nearness of m spots to n others, (m, n), 0 to 1.

    It is a Gaussian of the distance; 1 within an area, and 0 between an area and anything else or two floors.
    """
    squared = ((first.position[:, None] - second.position[None]) ** 2).sum(-1)
    same = (first.area[:, None] == second.area[None]) & (first.floor[:, None] == second.floor[None])
    inside = first.area[:, None] >= 0
    return np.where(same, np.where(inside, 1.0, np.exp(-squared / (2.0 * reach_px**2))), 0.0)


def support(indexed: IndexedMap, voters: Voters, *, at: Spots, reach: float) -> Array:
    """Compute the share of the squared votes around spots, summed over the photos of a place.

    Args:
        reach: Standard deviation of the window, place radii.

    Returns:
        (m,) float64: 0 to 1.
    """
    squared = voters.votes**2
    if not squared.any():
        return np.zeros(len(at.area))
    near = nearness(at, photo_spots(indexed, voters.photo), reach_px=reach * indexed.place_radius_px)
    share: Array = near @ squared / squared.sum()
    return share


def chance_support(indexed: IndexedMap, voters: Voters, *, reach: float) -> float:
    """Compute the mean support of the best place if the votes are cast for photos drawn at random."""
    rng = np.random.default_rng(_SEED)
    count, photos = len(voters.photo), len(indexed.ids)
    best = []
    for _ in range(_DRAWS):
        drawn = Voters(rng.choice(photos, count, replace=photos < count), voters.votes, voters.trust)
        best.append(
            support(indexed, drawn, at=photo_spots(indexed, drawn.photo), reach=reach).max(initial=0.0)
        )
    return max(float(np.mean(best)), _NO_SHARE)


def similarity_around(indexed: IndexedMap, alike: Array | None, *, at: Spots) -> Array:
    """Compute the highest similarity of the photos around spots, by global descriptors.

    Args:
        alike: (p,) float64 or None. Standard scores of the map's photos, -inf for those that are left out;
            None without a model.

    Returns:
        (m,) float64: Not negative; 0 if no photo around is more similar than the mean, and without a model.
    """
    if alike is None:
        return np.zeros(len(at.area))
    above = np.flatnonzero(alike > 0.0)
    near = nearness(at, photo_spots(indexed, above), reach_px=indexed.place_radius_px)
    found: Array = (near * alike[above]).max(axis=1, initial=0.0)
    return found


def evidence_vectors(
    indexed: IndexedMap,
    voters: Voters,
    *,
    at: Spots,
    score: Sequence[float],
    least_trust: Sequence[float] | None = None,
    alike: Array | None = None,
) -> NDArray[np.float64]:
    """Compute the evidence of each place, from which its probability follows.

    Args:
        at: The h places.
        score: Score of the pose at each, in photos that agree; 0 without a pose.
        least_trust: Trust in each place by its pose as a whole, in photos, if that is more than the trust in
            the photos around it.
        alike: (p,) float64. Standard scores of the map's photos by their global descriptors.

    Returns:
        (h, EVIDENCE) float64: Logarithms: of the score; of the support close to the place and in its
            surroundings, each over that by chance; of the trust in the photos around it; of the most votes of
            a photo over the median; of the similarity of the most similar photo around it, 0 without a model.
    """
    if not len(at.area):
        return np.zeros((0, EVIDENCE))
    near = nearness(at, photo_spots(indexed, voters.photo), reach_px=indexed.place_radius_px)
    trust = near @ voters.trust
    trusted = np.log1p(_TRUST_SCALE * (trust if least_trust is None else np.maximum(trust, least_trust)))
    voters = voters.with_votes()
    columns = [np.log1p(_AGREED_SCALE * np.asarray(score, np.float64))]
    for reach in indexed.tuning.places.support_reaches:
        found = support(indexed, voters, at=at, reach=reach) + _NO_SHARE
        columns.append(np.log(found / chance_support(indexed, voters, reach=reach)))
    most = voters.votes[: indexed.tuning.retrieval.shortlist]
    peak = float(np.log(most.max() / np.median(most))) if len(most) else 0.0
    similar = np.log1p(similarity_around(indexed, alike, at=at))
    return np.column_stack([*columns, trusted, np.full(len(at.area), peak), similar])
