"""What the fronts of one building have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.masonry import Colour, Material

Lintel = Literal["none", "beam", "gable", "arch"]


@dataclass(frozen=True, slots=True)
class Style:
    """How the fronts of one building look.

    Attributes
    ----------
    name : str
        On the sign over the door.
    material : {"brick", "stone", "boards", "plaster"}
    wall, trim, door, roof : tuple of int
        Colours.
    window_m : tuple of float
        Width and height of a window.
    spacing_m : float
        From the middle of one window to the next.
    panes : tuple of int
        Panes of a window, across and down.
    lintel : {"none", "beam", "gable", "arch"}
        Over each window.
    frame_px : int
        Width of the window frames, pixels of the texture.
    flower_boxes : float
        Share of the windows that have one.
    """

    name: str
    material: Material
    wall: Colour
    trim: Colour
    door: Colour
    roof: Colour
    window_m: tuple[float, float] = (1.1, 1.5)
    spacing_m: float = 2.3
    panes: tuple[int, int] = (2, 2)
    shutters: bool = False
    lintel: Lintel = "none"
    frame_px: int = 5
    flower_boxes: float = 0.0


def fill_box(image: NDArray[np.uint8], box: tuple[float, float, float, float], *, colour: Colour) -> None:
    """Fill a box given as left, top, right, bottom (pixels) in an (h, w, 3) uint8 picture."""
    left, top, right, bottom = (round(side) for side in box)
    cv2.rectangle(image, (left, top), (right - 1, bottom - 1), colour, -1)


def darker(colour: Colour, factor: float) -> Colour:
    """Multiply a colour by a factor below 1."""
    return (int(colour[0] * factor), int(colour[1] * factor), int(colour[2] * factor))
