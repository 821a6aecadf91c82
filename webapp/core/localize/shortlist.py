"""Which map photos are worth a closer look, and their matches with the query."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.localize.indexed import Candidates, IndexedMap


@dataclass(frozen=True, slots=True, eq=False)
class Shortlisted:
    """A map photo and its matches.

    Attributes
    ----------
    photo : int
        Its number in the map.
    votes : float
        Sum of the weights of its matches.
    query_row : (m,) int64
        Keypoints of the query, each at most once.
    query_xy, photo_xy : (m, 2) float32
        Their pixels in the upright photos.
    """

    photo: int
    votes: float
    query_row: NDArray[np.int64]
    query_xy: NDArray[np.float32]
    photo_xy: NDArray[np.float32]


def weighted_votes(found: Candidates, photos: int) -> NDArray[np.float64]:
    """Let every query descriptor vote for the photos of its neighbours.

    A vote's weight is how much nearer the neighbour is than the last one of the list, so that a descriptor
    that looks like everything says little (Jégou et al. 2008 have the same idea as a soft ratio test).

    Parameters
    ----------
    found : Candidates
        (n, k); the k-th neighbour is the yardstick.
    photos : int
        In the map.

    Returns
    -------
    (photos,) float64
    """
    near, photo = found.distance[:, :-1], found.photo[:, :-1]
    yardstick = np.where(np.isfinite(found.distance), found.distance, -np.inf).max(axis=1, keepdims=True)
    weight = np.where(photo >= 0, np.maximum(yardstick - near, 0.0), 0.0)
    voted = photo >= 0
    return np.bincount(photo[voted], weights=weight[voted], minlength=photos).astype(np.float64)


def shortlist(
    indexed: IndexedMap, query: Features, found: Candidates, *, votes: NDArray[np.float64], most: int
) -> list[Shortlisted]:
    """Take the photos with most votes and collect their matches.

    Parameters
    ----------
    indexed : IndexedMap
    query : Features
    found : Candidates
    votes : (p,) float64
    most : int
        At most so many photos.

    Returns
    -------
    list of Shortlisted
        Most votes first; only photos with at least one match.
    """
    order = np.argsort(-votes, kind="stable")[:most]
    order = order[votes[order] > 0.0]
    wanted = np.flatnonzero(np.isin(found.photo, order).ravel())
    photo, row = found.photo.ravel()[wanted], found.row.ravel()[wanted]
    query_row = wanted // found.photo.shape[1]
    listed = []
    for p in order:
        mine = np.flatnonzero(photo == p)
        # Neighbours come nearest first, so that the first of a keypoint is its best in this photo.
        rows, first = np.unique(query_row[mine], return_index=True)
        features = indexed.features(int(p))
        if features is None:
            continue
        theirs = row[mine[first]] - indexed.first_row_of(int(p))
        listed.append(
            Shortlisted(int(p), float(votes[p]), rows, query.xy[rows], np.asarray(features.xy[theirs]))
        )
    return listed
