"""What does the parts of some work, wherever that is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

LOOK_EVERY_S = 0.5
"""Seconds after which a wait ends, so that the work can be stopped."""

Part = Callable[[Any, Any], Any]
"""A function of a module: takes what all parts share, and the item; safe in several threads at once."""


class Pool(Protocol):
    """Does parts of some work."""

    @property
    def at_once(self) -> int:
        """Number of parts that may have begun or wait in it, which bounds the memory."""

    def submit(self, item: Any, *, of: int) -> Any:
        """Begin a part; returns what stands for it.

        Parameters
        ----------
        of : int
            Number of parts that are submitted or about to be: where there are few, each gets more cores.
        """

    def finished(self, waiting: Sequence[Any]) -> Iterator[Any]:
        """Give the results of the first parts that are finished, after a short wait for the first one."""

    def close(self, waiting: Sequence[Any]) -> None:
        """Drop the parts that have not begun, and end."""
