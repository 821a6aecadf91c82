"""An answer as text for the terminal."""

from __future__ import annotations

from webapp.core.geo.georeference import Georeference
from webapp.core.hypotheses.model import Answer, Hypothesis

_HEAD = ("", "probability", "x", "y", "radius", "heading", "latitude", "longitude", "inliers", "photos")


def answer_text(answer: Answer, *, query: str, georeference: Georeference | None) -> str:
    """Lay out the hypotheses as a table, with "not on this map" as a line of its own.

    Parameters
    ----------
    answer : Answer
    query : str
        The photo, as it was named.
    georeference : Georeference or None
        Of the map; gives latitude, longitude and metres.
    """
    if answer.no_pose is not None:
        return f"{query}: not on this map ({answer.no_pose.reason})"
    rows = [_HEAD, *(_row(h, georeference) for h in answer.hypotheses)]
    shown = [i for i in range(len(_HEAD)) if i == 0 or any(r[i] for r in rows[1:])]
    width = [max(len(r[i]) for r in rows) for i in shown]
    lines = ["  ".join(r[i].rjust(w) for i, w in zip(shown, width, strict=True)) for r in rows]
    if answer.other_probability >= 0.005:
        lines.append(f"   {_percent(answer.other_probability)} other places on this map")
    if answer.off_map_probability is not None:
        lines.append(f"   {_percent(answer.off_map_probability)} not on this map")
    return "\n".join([f"{query}: {_verdict(answer)}", *lines])


def _verdict(answer: Answer) -> str:
    best = answer.hypotheses[0]
    if answer.abstained:
        return "probably not on this map"
    where = f"x {best.position.x:.0f}, y {best.position.y:.0f}"
    if best.kind == "photo":
        return f"near the photo with id {best.experiences[0]} at {where}"
    return f"at {where}"


def _row(hypothesis: Hypothesis, georeference: Georeference | None) -> tuple[str, ...]:
    position, radius, heading = hypothesis.position, hypothesis.radius_px, hypothesis.heading_deg
    lat = lon = ""
    shown = "" if radius is None else f"{radius:.0f} px"
    if georeference is not None:
        latlon = georeference.latlon_of(position)
        lat, lon = f"{latlon.lat:.6f}", f"{latlon.lon:.6f}"
        if radius is not None:
            shown = f"{radius * georeference.metres_per_pixel(position):.1f} m"
    return (
        str(hypothesis.rank),
        _percent(hypothesis.probability).strip(),
        f"{position.x:.0f}",
        f"{position.y:.0f}",
        shown,
        "" if heading is None else f"{heading:.0f}°",
        lat,
        lon,
        "" if hypothesis.inliers is None else str(hypothesis.inliers),
        " ".join(str(e) for e in hypothesis.experiences[:4])
        + (" …" if len(hypothesis.experiences) > 4 else ""),
    )


def _percent(probability: float) -> str:
    if 0.0 < probability < 0.01:
        return " <1 %"
    if 0.99 < probability < 1.0:
        return ">99 %"
    return f"{100.0 * probability:3.0f} %"
