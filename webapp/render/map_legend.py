"""The band below a map picture that says what its colours and marks mean."""

from __future__ import annotations

from webapp.core.hypotheses.model import Answer
from webapp.render.canvas import Canvas, text_width
from webapp.render.colours import EXPERIENCE, INK, QUIET, TRUTH, probability_colour

BAND_PX = 104
_NAMED = 5
"""Places whose probability is written out; the colours tell the others."""

_TEXT, _SMALL, _MARGIN, _BAR_PX = 20, 16, 16, 260


def draw_legend(
    canvas: Canvas, answer: Answer, *, top: int, scale_bar: tuple[float, str], truth: bool
) -> None:
    """Draw the legend.

    Parameters
    ----------
    canvas : Canvas
    answer : Answer
    top : int
        Where the band begins.
    scale_bar : (float, str)
        Length in pixels and label.
    truth : bool
        Whether the picture marks the true position.
    """
    canvas.text((_MARGIN, top + 34), headline(answer), size=_TEXT)
    y = top + 70
    x = _probability_bar(canvas, y)
    x = _mark(canvas, (x, y), "photo of the map")
    if any(h.radius_px is not None for h in answer.hypotheses):
        x = _mark(canvas, (x, y), "68 % radius")
    if truth:
        x = _mark(canvas, (x, y), "true position")
    length, label = scale_bar
    right = canvas.size[0] - _MARGIN
    canvas.line((right - length, y), (right, y), colour=INK, width=2)
    for end in (right - length, right):
        canvas.line((end, y - 5), (end, y + 5), colour=INK, width=2)
    canvas.text((right, y + 22), label, size=_SMALL, colour=QUIET, anchor="rs")


def headline(answer: Answer) -> str:
    """Say the answer in a line: the places, or why there is none, and what is left for elsewhere."""
    parts = []
    if answer.hypotheses:
        named = (f"{h.rank}: {_percent(h.probability)}" for h in answer.hypotheses[:_NAMED])
        parts.append("Place " + ",  ".join(named))
        if answer.abstained:
            parts.insert(0, "Probably not on this map")
    elif answer.no_pose is not None:
        parts.append(f"No place found: {answer.no_pose.reason}")
    if answer.other_probability > 0:
        parts.append(f"places not shown: {_percent(answer.other_probability)}")
    if answer.off_map_probability is not None:
        parts.append(f"not on this map: {_percent(answer.off_map_probability)}")
    return "  ·  ".join(parts)


def _percent(probability: float) -> str:
    percent = 100 * probability
    if 0 < percent < 1:
        return "under 1 %"
    return "over 99 %" if 99 < percent < 100 else f"{percent:.0f} %"


def _probability_bar(canvas: Canvas, y: int) -> float:
    for i in range(_BAR_PX):
        canvas.box((_MARGIN + i, y - 6), (1, 12), colour=probability_colour(i / (_BAR_PX - 1)))
    for x, words, anchor in (
        (_MARGIN, "0", "ls"),
        (_MARGIN + _BAR_PX / 2, "probability of a place", "ms"),
        (_MARGIN + _BAR_PX, "1", "rs"),
    ):
        canvas.text((x, y + 22), words, size=_SMALL, colour=QUIET, anchor=anchor)
    return _MARGIN + _BAR_PX + 36


def _mark(canvas: Canvas, at: tuple[float, int], words: str) -> float:
    """Draw one mark with its meaning; gives where the next one begins."""
    x, y = at
    middle = (x + 8, y)
    if words == "photo of the map":
        canvas.disc(middle, 5, colour=INK)
        canvas.disc(middle, 4, colour=EXPERIENCE)
    elif words == "true position":
        canvas.disc(middle, 2, colour=TRUTH)
        for dx, dy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            canvas.line((x + 8 + 5 * dx, y + 5 * dy), (x + 8 + 10 * dx, y + 10 * dy), colour=TRUTH, width=2)
    else:
        canvas.ring(middle, 8, colour=QUIET, width=2)
    canvas.text((x + 26, y), words, size=_SMALL, colour=INK, anchor="lm")
    return x + 26 + text_width(words, _SMALL) + 30
