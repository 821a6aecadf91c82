"""The belief about a sequence as a JSON object, to go on with it later."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Hypothesis
from webapp.core.hypotheses.sequence import Belief
from webapp.core.hypotheses.tracks import Track


def belief_to_json(belief: Belief) -> dict[str, Any]:
    """Make plain values of a belief."""
    return asdict(belief)


def belief_from_json(form: dict[str, Any]) -> Belief:
    """Read what `belief_to_json` made.

    Raises
    ------
    KeyError, TypeError
        It is something else.
    """
    return Belief(tuple(_track(t) for t in form["tracks"]), float(form["lost"]), int(form["frames"]))


def _track(form: dict[str, Any]) -> Track:
    spoke = dict(form["hypothesis"])
    spoke["position"] = MapPixel(*spoke["position"])
    spoke["experiences"] = tuple(spoke["experiences"])
    plain = {name: tuple(form[name]) for name in ("x", "y", "covariance")}
    return Track(weight=form["weight"], hypothesis=Hypothesis(**spoke), seen=form["seen"], **plain)
