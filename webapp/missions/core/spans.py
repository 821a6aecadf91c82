"""Spans of time, of which what overlaps counts once."""

from __future__ import annotations

from bisect import bisect_left, bisect_right


class Spans:
    """Disjoint spans, sorted."""

    def __init__(self) -> None:
        self._first: list[float] = []
        self._last: list[float] = []

    def add(self, first: float, last: float) -> float:
        """Add a span; return the share of it that no other has covered: of a moment 0 or 1."""
        begin, end = bisect_left(self._last, first), bisect_right(self._first, last)
        before = list(zip(self._first[begin:end], self._last[begin:end], strict=True))
        covered = sum(min(b, last) - max(a, first) for a, b in before)
        self._first[begin:end] = [min(first, *(a for a, _ in before))] if before else [first]
        self._last[begin:end] = [max(last, *(b for _, b in before))] if before else [last]
        if last > first:
            return 1.0 - covered / (last - first)
        return 0.0 if before else 1.0

    @property
    def length(self) -> float:
        """Length of all of them."""
        return sum(b - a for a, b in zip(self._first, self._last, strict=True))
