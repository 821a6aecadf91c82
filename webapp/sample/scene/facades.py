"""Pictures of house fronts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene import decoration
from webapp.sample.scene.masonry import PIXELS_PER_METRE, surface
from webapp.sample.scene.openings import door, window
from webapp.sample.scene.style import Style, darker, fill_box

FLOOR_M = 3.3


def front(
    rng: np.random.Generator, size_m: tuple[float, float], *, style: Style, entrance: bool
) -> NDArray[np.uint8]:
    """Paint one front of a building.

    Parameters
    ----------
    rng : numpy.random.Generator
    size_m : tuple of float
        Width and height.
    style : Style
    entrance : bool
        With a door and the sign; other fronts get something else to be known by.

    Returns
    -------
    (h, w, 3) uint8
        `PIXELS_PER_METRE` pixels a metre.
    """
    width, height = (round(side * PIXELS_PER_METRE) for side in size_m)
    wall = surface(rng, (height, width), material=style.material, colour=style.wall)
    columns = max(1, int((size_m[0] - 0.8) // style.spacing_m))
    painted = not entrance and rng.random() < 0.45
    door_column = int(rng.integers(1, max(2, columns - 1))) if entrance else -1
    for floor in range(max(1, int(size_m[1] // FLOOR_M))):
        ground = height - round(floor * FLOOR_M * PIXELS_PER_METRE)
        if floor:
            fill_box(wall, (0, ground - 7, width, ground + 2), colour=style.trim)
            fill_box(wall, (0, ground + 2, width, ground + 5), colour=darker(style.trim, 0.6))
        for column in range(columns):
            middle = round((column + 0.5) * width / columns)
            if floor == 0 and column == door_column:
                door(rng, wall, foot=(middle, height), style=style)
            elif rng.random() < 0.93 and not (painted and floor == 0):
                window(rng, wall, foot=(middle, ground), style=style)
    if entrance:
        middle = round((door_column + 0.5) * width / columns)
        decoration.sign(wall, middle=(middle, height - round(2.75 * PIXELS_PER_METRE)), style=style)
    elif painted:
        decoration.mural(rng, wall)
    else:
        decoration.ivy(rng, wall)
    for gap in () if painted else rng.permutation(columns - 1)[: int(rng.integers(1, 4))]:
        decoration.poster(rng, wall, middle=round((int(gap) + 1) * width / columns))
    decoration.drainpipe(rng, wall)
    return wall
