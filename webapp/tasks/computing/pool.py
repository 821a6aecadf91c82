"""Interface of the pools that run parts, here or on other machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

LOOK_EVERY_S = 0.5
"""Maximum duration of a wait, so that the work can be cancelled."""

Part = Callable[[Any, Any], Any]
"""A module-level, thread-safe function of the shared value and an item."""


class Pool(Protocol):
    """Runs parts of some work."""

    @property
    def at_once(self) -> int:
        """Maximum number of submitted parts, which bounds the memory."""

    def submit(self, item: Any, *, of: int) -> Any:
        """Submit a part; return its handle.

        Args:
            of: Number of parts that are submitted or about to be: with few, each gets more cores.
        """

    def finished(self, waiting: Sequence[Any]) -> Iterator[Any]:
        """Yield the results of the first parts that are finished, after a short wait for the first one."""

    def close(self, waiting: Sequence[Any]) -> None:
        """Cancel pending parts and shut down."""
