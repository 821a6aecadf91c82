"""Linear assignment of columns to rows: as many rows as possible get one, at the least sum of costs.

Connected components (rows that share columns, directly or through other rows) are solved separately. One of
more than MOST_TOGETHER rows is solved greedily, the cheapest pair first: the exact solution takes time cubic
in the number of rows.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

MOST_TOGETHER = 100
"""Largest number of rows solved exactly; so many columns per row are then enough."""

_UNMATCHED = 1e6
"""Cost of no column: more than the sum over any MOST_TOGETHER rows."""

Floats = NDArray[np.float64]
Costs = dict[int, float]
"""Costs of a row, by column; columns that it must not get are missing."""


def assign(rows: Sequence[Costs]) -> dict[int, int]:
    """Assign columns to rows; rows that get none are left out."""
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
        for row in found:  # the list grows in the loop
            for column in rows[row]:
                fresh = [other for other in rows_of.pop(column, ()) if other not in seen]
                seen.update(fresh)
                found.extend(fresh)
        yield sorted(found)


def _exact(some: dict[int, Costs]) -> dict[int, int]:
    """Assign at the least sum; a row may also stay without a column, at the cost `_UNMATCHED`."""
    columns = sorted({column for costs in some.values() for column in costs})
    place = {column: number for number, column in enumerate(columns)}
    table = np.full((len(some), len(columns) + len(some)), _UNMATCHED)
    for n, costs in enumerate(some.values()):
        table[n, [place[column] for column in costs]] = list(costs.values())
    found = zip(some, linear_assignment(table), strict=True)
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


def linear_assignment(costs: Floats) -> list[int]:
    """Choose a column for each row of (n, m) costs, n <= m, at the least sum: Kuhn's method with potentials.

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
