"""The lines of a `.cfg` as far as they could be read; what could not be is None."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ImageLine:
    """The first line: satellite image, width and height in pixels.

    `columns` holds where each of the three begins, from 1.
    """

    image: str | None
    width: int | None
    height: int | None
    columns: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class PhotoLine:
    """One experience: id, photo, pixels from the left edge and from the top edge.

    `line` counts from 1; `columns` holds where each of the four begins, from 1.
    """

    line: int
    id: int | None
    photo: str | None
    x: int | None
    y: int | None
    columns: tuple[int, int, int, int]

    def text(self, *, x: int | None = None, y: int | None = None, id: int | None = None) -> str:
        """Write the line in canonical form, with other values where given."""
        values = (
            self.id if id is None else id,
            self.photo,
            self.x if x is None else x,
            self.y if y is None else y,
        )
        return ";".join("?" if value is None else str(value) for value in values)
