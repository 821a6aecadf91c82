"""Small charts as SVG for the report; the page's style sheet gives them their colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from webapp.core.evaluation.metrics import ReliabilityBin, error_curve, wilson_interval

WIDTH, HEIGHT = 520, 340
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 28, 14, 48
_DOT = 5


@dataclass(frozen=True, slots=True)
class Axis:
    label: str
    # Values and their labels; the first and the last are the ends of the axis.
    ticks: tuple[tuple[float, str], ...]
    log: bool = False

    def fraction(self, value: float) -> float:
        """Return where a value lies between the ends, 0 to 1; values outside are clipped."""
        low, high = self.ticks[0][0], self.ticks[-1][0]
        at = min(max(value, low), high)
        if self.log:
            return math.log(at / low) / math.log(high / low)
        return (at - low) / (high - low)


@dataclass(frozen=True, slots=True)
class ChartWords:
    """Texts in the charts; a page in another language passes its own."""

    error_title: str = "Error curve: share of queries with at most this error"
    error: str = "error of the first hypothesis, map pixels"
    queries: str = "queries"
    place_radius: str = "place radius"
    reliability_title: str = "Reliability: share of right answers over stated probability"
    stated: str = "stated probability of the first hypothesis"
    right: str = "share of right answers"
    diagonal: str = "perfect calibration"
    bin: str = "{count} queries: {stated} stated, {right} right"
    vertical: str = "vertical axis"


_ENGLISH = ChartWords()

SHARE = tuple((percent / 100, f"{percent} %") for percent in (0, 25, 50, 75, 100))


def error_chart(
    errors: NDArray[np.float64], *, place_radius_px: float, words: ChartWords = _ENGLISH
) -> Markup:
    """Draw the share of the queries with at most a given error, over the error on a logarithmic axis.

    Args:
        errors: (n,) float64. Of the first hypotheses, map pixels; infinite without a hypothesis.
        place_radius_px: Marked by a line.
    """
    values, shares = error_curve(errors)
    largest = max(float(values[-1]) if values.size else 1.0, place_radius_px, 100.0)
    decades = math.ceil(math.log10(largest))
    ticks = tuple((10.0**i, f"{10**i}") for i in range(decades + 1))
    x, y = Axis(words.error, ticks, log=True), Axis(words.queries, SHARE)
    steps = [f"M{_x(x, 1)} {_y(y, 0)}"]
    for value, share in zip(values, shares, strict=True):
        steps.append(f"H{_x(x, float(value))}V{_y(y, float(share))}")
    steps.append(f"H{_x(x, ticks[-1][0])}")
    at = _x(x, place_radius_px)
    label = ("note", at + 6) if at < WIDTH / 2 else ("note end", at - 6)  # where it fits
    body = (
        Markup('<path class="guide" d="M{0} {1}V{2}"/>').format(at, _TOP, HEIGHT - _BOTTOM)
        + Markup('<text class="{0}" x="{1}" y="{2}">{3}</text>').format(
            *label, HEIGHT - _BOTTOM - 8, words.place_radius
        )
        + Markup('<path class="curve" d="{0}"/>').format("".join(steps))
    )
    return _chart((x, y), body, title=words.error_title, words=words)


def reliability_chart(bins: Sequence[ReliabilityBin], *, words: ChartWords = _ENGLISH) -> Markup:
    """Draw the share of right answers over stated probability, in bins of equal mass with 95 % intervals."""
    x = Axis(words.stated, SHARE)
    y = Axis(words.right, SHARE)
    diagonal = Markup('<path class="guide" d="M{0} {1}L{2} {3}"/>')
    body = diagonal.format(_x(x, 0), _y(y, 0), _x(x, 1), _y(y, 1))
    body += Markup('<text class="note end" x="{0}" y="{1}">{2}</text>').format(
        _x(x, 0.98), _y(y, 0.68), words.diagonal
    )
    for one in bins:
        low, high = wilson_interval(one.right, one.count)
        at = _x(x, one.probability)
        tooltip = words.bin.format(count=one.count, stated=f"{one.probability:.0%}", right=f"{one.right:.0%}")
        body += Markup(
            '<g><title>{0}</title><path class="whisker" d="M{1} {2}V{3}"/>'
            '<circle class="dot" cx="{1}" cy="{4}" r="{5}"/></g>'
        ).format(tooltip, at, _y(y, low), _y(y, high), _y(y, one.right), _DOT)
    return _chart((x, y), body, title=words.reliability_title, words=words)


def _chart(axes: tuple[Axis, Axis], body: Markup, *, title: str, words: ChartWords) -> Markup:
    x, y = axes
    right, bottom = WIDTH - _RIGHT, HEIGHT - _BOTTOM
    grid = Markup("")
    for value, text in y.ticks:
        at = _y(y, value)
        grid += Markup('<path class="grid" d="M{0} {1}H{2}"/>').format(_LEFT, at, right)
        grid += Markup('<text class="tick end" x="{0}" y="{1}">{2}</text>').format(_LEFT - 8, at + 4, text)
    for value, text in x.ticks:
        at = _x(x, value)
        grid += Markup('<path class="grid" d="M{0} {1}V{2}"/>').format(at, _TOP, bottom)
        grid += Markup('<text class="tick middle" x="{0}" y="{1}">{2}</text>').format(at, bottom + 18, text)
    labels = Markup('<text class="label middle" x="{0}" y="{1}">{2}</text>').format(
        (_LEFT + right) / 2, HEIGHT - 8, x.label
    )
    return Markup(
        '<svg class="chart" viewBox="0 0 {0} {1}" role="img" aria-label="{2}">{3}{4}{5}</svg>'
    ).format(WIDTH, HEIGHT, escape(f"{title} ({words.vertical}: {y.label})"), grid, labels, body)


def _x(axis: Axis, value: float) -> float:
    return round(_LEFT + axis.fraction(value) * (WIDTH - _LEFT - _RIGHT), 1)


def _y(axis: Axis, value: float) -> float:
    return round(HEIGHT - _BOTTOM - axis.fraction(value) * (HEIGHT - _TOP - _BOTTOM), 1)
