"""First stage of a query: find the map photos that may show the same scene."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.retrieval.indexed import Candidates, IndexedMap, candidates
from webapp.core.retrieval.shortlist import (
    ShortlistedPhoto,
    filter_by_rotation,
    shortlist,
    weighted_votes,
)
from webapp.core.retrieval.similar import standard_scores, with_similar


@dataclass(frozen=True, slots=True, eq=False)
class Retrieved:
    """The photos of a map that match a query."""

    nearest: Candidates  # (n, k): the nearest map descriptors of each query descriptor
    found: Candidates  # Those of them with the dominant rotation
    votes: NDArray[np.float64]  # (p,) float64. Of all photos.
    # `listed`, `further`: The shortlist, and further photos with votes, which are not verified.
    listed: list[ShortlistedPhoto]
    further: list[ShortlistedPhoto]
    # (p,) float64 or None. Standard scores by global descriptors; None without these.
    alike: NDArray[np.float64] | None


def retrieve(indexed: IndexedMap, query: Features, *, hide: Collection[int] = ()) -> Retrieved:
    """List the photos with most votes, and those most similar by global descriptors, if there are any.

    Args:
        hide: Experience ids to leave out.
    """
    tuning = indexed.tuning.retrieval
    nearest = candidates(indexed, query.descriptors, k=tuning.neighbours + 1, hide=hide)
    found = filter_by_rotation(indexed, query, found=nearest)
    votes = weighted_votes(found, len(indexed.ids))
    voting = shortlist(indexed, query, found=found, votes=votes, most=max(tuning.voters, tuning.shortlist))
    listed, further = voting[: tuning.shortlist], voting[tuning.shortlist :]
    alike = standard_scores(indexed, query, hide=hide)
    if alike is not None:
        listed, further = with_similar(indexed, query, voting=voting, votes=votes, alike=alike)
    return Retrieved(nearest, found, votes, listed, further, alike)
