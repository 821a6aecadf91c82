"""The park from straight above, as a satellite sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.camera import Camera
from webapp.sample.scene.plan import DEPTH_M, WIDTH_M
from webapp.sample.scene.render import render
from webapp.sample.scene.stage import Stage

_ALTITUDE_M = 4000.0


def overhead(stage: Stage, metres_per_pixel: float, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Take a picture from so high above that roofs hardly hide their walls.

    Parameters
    ----------
    metres_per_pixel : float
        Of the ground.
    rng : numpy.random.Generator
        For the camera's noise.

    Returns
    -------
    (h, w, 3) uint8
        Red, green, blue; north is up, and the ground fills the park's rectangle exactly.
    """
    width, height = round(WIDTH_M / metres_per_pixel), round(DEPTH_M / metres_per_pixel)
    fov = 2 * np.degrees(np.arctan(WIDTH_M / 2 / _ALTITUDE_M))
    camera = Camera((WIDTH_M / 2, DEPTH_M / 2, _ALTITUDE_M), 0.0, float(fov), width, height, pitch_deg=-90.0)
    return render(stage, camera, rng=rng)
