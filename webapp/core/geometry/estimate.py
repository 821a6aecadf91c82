"""Value that represents a failed estimate."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NoPose:
    """No pose could be estimated, and the reason. Falsy."""

    reason: str
    blank: bool = False  # The photo has nothing to recognise, which says nothing about the place

    def __bool__(self) -> bool:
        return False
