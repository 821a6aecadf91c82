"""The belief about a sequence as a JSON object, to continue it later."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.mixture import Component
from webapp.core.hypotheses.model import Hypothesis
from webapp.core.hypotheses.sequence import Belief


def belief_to_json(belief: Belief) -> dict[str, Any]:
    """Convert a belief to plain values; its components are named `tracks`, as in stored sequences."""
    return {
        "tracks": [asdict(component) for component in belief.components],
        "lost": belief.lost,
        "frames": belief.frames,
        "named": belief.named,
        "off": belief.off,
    }


def belief_from_json(form: dict[str, Any]) -> Belief:
    """Read what `belief_to_json` made.

    Raises
    ------
    KeyError, TypeError
        It is something else.
    """
    numbers = (float(form[name]) for name in ("named", "off"))
    components = tuple(_component(t) for t in form["tracks"])
    return Belief(components, float(form["lost"]), int(form["frames"]), *numbers)


def _component(form: dict[str, Any]) -> Component:
    hypothesis = dict(form["hypothesis"])
    hypothesis["position"] = MapPixel(*hypothesis["position"])
    hypothesis["experiences"] = tuple(hypothesis["experiences"])
    plain = {name: tuple(form[name]) for name in ("x", "y", "covariance")}
    return Component(weight=form["weight"], hypothesis=Hypothesis(**hypothesis), seen=form["seen"], **plain)
