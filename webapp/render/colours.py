"""Colours of the pictures: an accessible scale for probabilities, and the colours used with it.

The scale is viridis: its lightness grows evenly, so that it can be read by brightness alone, also by
colour-blind people and in greyscale (Nathaniel Smith and Stéfan van der Walt, 2015; public domain).
"""

from __future__ import annotations

import numpy as np

RGB = tuple[int, int, int]

_STOPS = np.array(
    [
        (68, 1, 84),
        (71, 45, 123),
        (59, 82, 139),
        (44, 114, 142),
        (33, 145, 140),
        (40, 174, 128),
        (94, 201, 98),
        (173, 220, 48),
        (253, 231, 37),
    ],
    dtype=np.float64,
)

EXPERIENCE: RGB = (255, 255, 255)
"""A photo of the map: not on the scale, and visible on any background with its dark rim."""

TRUTH: RGB = (214, 40, 90)
"""The true position: the only red mark in a picture."""

INLIER: RGB = (255, 208, 0)
"""A match that agrees with the geometry."""

OUTLIER: RGB = (255, 255, 255)
"""A match that does not; drawn faintly."""

INK: RGB = (27, 36, 44)
"""Text and rims."""

QUIET: RGB = (92, 105, 116)
"""Secondary text."""

PAPER: RGB = (250, 251, 252)
"""Background of captions."""


def probability_colour(probability: float) -> RGB:
    """Return the colour of a probability: dark violet at 0, bright yellow at 1.

    Returns:
        Red, green, blue, 0 to 255.
    """
    at = float(np.clip(probability, 0.0, 1.0)) * (len(_STOPS) - 1)
    red, green, blue = (round(float(np.interp(at, range(len(_STOPS)), channel))) for channel in _STOPS.T)
    return red, green, blue


def luminance(colour: RGB) -> float:
    """Return the relative luminance of an sRGB colour, 0 (black) to 1 (white), as WCAG 2 defines it."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (v / 255 for v in colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def text_on(ground: RGB) -> RGB:
    """Return ink or white, whichever is more legible on a background."""
    return INK if luminance(ground) > 0.18 else (255, 255, 255)
