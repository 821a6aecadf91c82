"""Which row gets which column: as many rows as can be get one, at the least sum of costs.

Rows that share no column, not even through other rows, are assigned on their own. More than MOST_TOGETHER
rows that belong together are assigned greedily, the cheapest pair first: the least sum would take a time that
grows with the cube of their number.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

MOST_TOGETHER = 100
"""So many rows get the least sum; also, so many columns of a row are enough for it."""

_UNMATCHED = 1e6
"""More than all pairs of MOST_TOGETHER rows cost together."""

Floats = NDArray[np.float64]
Costs = dict[int, float]
"""Of a row, by column; columns that it must not get are not in it."""


def assign(rows: Sequence[Costs]) -> dict[int, int]:
    """Choose columns by rows; rows that get none are left out."""
    chosen: dict[int, int] = {}
    for together in _components(rows):
        some = {row: rows[row] for row in together}
        chosen.update(_exact(some) if len(some) <= MOST_TOGETHER else _greedy(some))
    return chosen


def _components(rows: Sequence[Costs]) -> Iterator[list[int]]:
    """Group rows that share columns, directly or through other rows; rows without columns are left out."""
    rows_of: dict[int, list[int]] = defaultdict(list)
    for row, costs in enumerate(rows):
        for column in costs:
            rows_of[column].append(row)
    seen: set[int] = set()
    for first, costs in enumerate(rows):
        if first in seen or not costs:
            continue
        seen.add(first)
        found = [first]
        for row in found:  # grows
            for column in rows[row]:
                fresh = [other for other in rows_of.pop(column, ()) if other not in seen]
                seen.update(fresh)
                found.extend(fresh)
        yield sorted(found)


def _exact(some: dict[int, Costs]) -> dict[int, int]:
    """Choose at the least sum: each row may also stay without a column, which costs most."""
    columns = sorted({column for costs in some.values() for column in costs})
    place = {column: number for number, column in enumerate(columns)}
    table = np.full((len(some), len(columns) + len(some)), _UNMATCHED)
    for n, costs in enumerate(some.values()):
        table[n, [place[column] for column in costs]] = list(costs.values())
    found = zip(some, least_sum(table), strict=True)
    return {row: columns[n] for row, n in found if n < len(columns) and columns[n] in some[row]}


def _greedy(some: dict[int, Costs]) -> dict[int, int]:
    pairs = sorted((cost, row, column) for row, costs in some.items() for column, cost in costs.items())
    chosen: dict[int, int] = {}
    taken: set[int] = set()
    for _, row, column in pairs:
        if row not in chosen and column not in taken:
            chosen[row] = column
            taken.add(column)
    return chosen


def least_sum(costs: Floats) -> list[int]:
    """Choose a column for each row (n, m), n <= m, of the least sum: Kuhn's method, with potentials.

    R. Burkard, M. Dell'Amico and S. Martello, Assignment Problems (2009), section 4.2.
    """
    n, m = costs.shape
    of_row, of_column = np.zeros(n), np.zeros(m)
    row_of: NDArray[np.intp] = np.full(m, -1)
    for first in range(n):
        least, way = np.full(m, np.inf), np.full(m, -1)
        reached: list[int] = []
        row, column = first, -1
        while row >= 0:
            slack = costs[row] - of_row[row] - of_column
            better = slack < least
            better[reached] = False
            least[better], way[better] = slack[better], column
            open_ = least.copy()
            open_[reached] = np.inf
            column = int(np.argmin(open_))
            step = open_[column]
            of_row[[first, *row_of[reached]]] += step
            of_column[reached] -= step
            least -= step
            reached.append(column)
            row = int(row_of[column])
        while column >= 0:
            before = int(way[column])
            row_of[column] = row_of[before] if before >= 0 else first
            column = before
    return [int(np.flatnonzero(row_of == row)[0]) for row in range(n)]
