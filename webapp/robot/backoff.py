"""Exponential backoff."""

from __future__ import annotations

import random


class Backoff:
    """Delays that double with each failure, with jitter so that robots do not retry all at once."""

    def __init__(self, first_s: float, longest_s: float, *, rng: random.Random | None = None) -> None:
        self._first_s = first_s
        self._longest_s = longest_s
        self._rng = rng or random.Random()
        self._failures = 0

    def next_delay(self, *, at_least_s: float = 0.0) -> float:
        """Return how many seconds to wait after one more failure.

        Parameters
        ----------
        at_least_s : float
            What the server asked for.
        """
        usual = min(self._first_s * 2.0 ** min(self._failures, 30), self._longest_s)
        self._failures += 1
        return at_least_s + usual * self._rng.uniform(0.5, 1.0)

    def reset(self) -> None:
        """Start with the shortest delay again."""
        self._failures = 0
