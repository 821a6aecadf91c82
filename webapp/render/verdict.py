"""The rule by which an answer is certain, uncertain, or not on the map; pages have it in `verdict.js`."""

from __future__ import annotations

from typing import Literal

from webapp.core.hypotheses.model import Answer

Verdict = Literal["off_map", "perhaps_off_map", "perhaps_place", "place"]

_LIKELY = 0.5


def verdict_of(answer: Answer) -> Verdict:
    """Say what leads in an answer, and whether it is as probable as all else together."""
    off_map = answer.off_map_probability
    if answer.abstained:
        return "off_map" if off_map is None or off_map >= _LIKELY else "perhaps_off_map"
    # The shares of `vote`, which knows no "not on this map", are no probabilities.
    certain = off_map is None or answer.hypotheses[0].probability >= _LIKELY
    return "place" if certain else "perhaps_place"
