"""The colours of an answer, the same on pages as in pictures."""

from __future__ import annotations

from typing import Any

from webapp.render.colours import INK, INLIER, OUTLIER, RGB, TRUTH, probability_colour, text_on

_STEPS = 100


def answer_colours() -> dict[str, Any]:
    """Give the colours of the pictures to the page: fill and text for each percent of probability."""
    scale = [probability_colour(step / _STEPS) for step in range(_STEPS + 1)]
    return {
        "scale": [_css(colour) for colour in scale],
        "text": [_css(text_on(colour)) for colour in scale],
        "inlier": _css(INLIER),
        "outlier": _css(OUTLIER),
        "ink": _css(INK),
        "truth": _css(TRUTH),
    }


def _css(colour: RGB) -> str:
    return "#" + bytes(colour).hex()
