"""Verdict on an answer (certain, uncertain, not on the map, nothing to see), and its sentence."""

from __future__ import annotations

from typing import Any, Literal

from webapp.core.hypotheses.model import Answer

Verdict = Literal["off_map", "perhaps_off_map", "perhaps_place", "place", "nothing_to_see"]

SENTENCES: dict[tuple[Verdict, str], str] = {
    ("place", "position"): "At x %(x)s, y %(y)s.",
    ("place", "area"): "In the area at x %(x)s, y %(y)s.",
    ("place", "photo"): "Near the photo with id %(id)s at x %(x)s, y %(y)s.",
    ("perhaps_place", "position"): "Uncertain, perhaps at x %(x)s, y %(y)s.",
    ("perhaps_place", "area"): "Uncertain, perhaps in the area at x %(x)s, y %(y)s.",
    ("perhaps_place", "photo"): "Uncertain, perhaps near the photo with id %(id)s at x %(x)s, y %(y)s.",
    ("perhaps_off_map", ""): "Uncertain, perhaps not on this map.",
    ("off_map", ""): "Probably not on this map.",
    ("nothing_to_see", ""): "Nothing to recognise in this photo: it is too dark, too plain or too blurred.",
}
"""By verdict and kind of the first place; the kind is empty where no place leads."""

_LIKELY = 0.5


def verdict_of(answer: Answer) -> Verdict:
    """Return the verdict: what leads, and whether it is as probable as everything else together."""
    if answer.no_pose is not None and answer.no_pose.blank:
        return "nothing_to_see"
    off_map = answer.off_map_probability
    if answer.abstained:
        return "off_map" if off_map is None or off_map >= _LIKELY else "perhaps_off_map"
    # `vote` does not estimate "not on this map"; its shares of the votes are not probabilities.
    certain = off_map is None or answer.hypotheses[0].probability >= _LIKELY
    return "place" if certain else "perhaps_place"


def sentence_parts(answer: Answer) -> tuple[str, dict[str, Any]]:
    """Return one of `SENTENCES`, untranslated, and the values to insert."""
    verdict = verdict_of(answer)
    if verdict in ("off_map", "perhaps_off_map", "nothing_to_see"):
        return SENTENCES[verdict, ""], {}
    best = answer.hypotheses[0]
    values: dict[str, Any] = {"x": f"{best.position.x:.0f}", "y": f"{best.position.y:.0f}"}
    if best.kind == "photo":
        values["id"] = best.experiences[0]
    return SENTENCES[verdict, best.kind], values


def sentence_of(answer: Answer) -> str:
    """Return an answer as one English sentence; places are in map pixels."""
    text, values = sentence_parts(answer)
    return text % values
