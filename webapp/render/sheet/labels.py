"""Places labels next to their marks without overlaps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

_CELL = 16.0
"""Side of the cells of the grid in which boxes are looked up, points."""


class Box(NamedTuple):
    """A rectangle, y down."""

    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, other: Box) -> bool:
        """Return whether two boxes have more than an edge in common."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )

    def within(self, other: Box) -> bool:
        """Return whether all of it is inside the other one."""
        return (
            other.left <= self.left
            and self.right <= other.right
            and other.top <= self.top
            and self.bottom <= other.bottom
        )


class LabelWanted(NamedTuple):
    """A label, and the mark that it belongs to."""

    # `x`, `y`, `reach`: Centre and radius of the mark.
    x: float
    y: float
    reach: float
    # `width`, `height`: Of the label.
    width: float
    height: float


class _Taken:
    """The boxes that are already on the sheet, in a grid."""

    def __init__(self, boxes: Iterable[Box]) -> None:
        self._cells: dict[tuple[int, int], list[Box]] = defaultdict(list)
        for box in boxes:
            self.add(box)

    def add(self, box: Box) -> None:
        for cell in _cells(box):
            self._cells[cell].append(box)

    def free(self, box: Box) -> bool:
        return not any(box.overlaps(other) for cell in _cells(box) for other in self._cells.get(cell, ()))


def place_labels(wanted: Sequence[LabelWanted], *, taken: Iterable[Box], frame: Box) -> list[Box | None]:
    """Place labels around their marks so that they overlap neither a mark nor one another.

    Args:
        wanted: In the order of priority.
        taken: Areas that must stay visible: the marks.

    Returns:
        None for labels that do not fit.
    """
    there, found = _Taken(taken), list[Box | None]()
    for label in wanted:
        box = next((b for b in _around(label) if b.within(frame) and there.free(b)), None)
        if box is not None:
            there.add(box)
        found.append(box)
    return found


def _around(label: LabelWanted) -> Iterator[Box]:
    """Yield the possible places of a label: right, left, above, below, then the corners."""
    x, y, reach, width, height = label
    near = 0.75 * reach
    beside = [(reach, -height / 2), (-reach - width, -height / 2)]
    over_and_under = [(-width / 2, -reach - height), (-width / 2, reach)]
    corners = [(dx, dy) for dx in (near, -near - width) for dy in (-near - height, near)]
    for dx, dy in (*beside, *over_and_under, *corners):
        yield Box(x + dx, y + dy, x + dx + width, y + dy + height)


def _cells(box: Box) -> Iterator[tuple[int, int]]:
    for column in range(int(box.left // _CELL), int(box.right // _CELL) + 1):
        for row in range(int(box.top // _CELL), int(box.bottom // _CELL) + 1):
            yield column, row
