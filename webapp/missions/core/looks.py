"""How tracks and drawings look, on pages and in files: what people have set, else by source or state."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import Any

from webapp.core import texts

SOURCE_COLOURS = {
    "gps": "#0072b2",
    "odometry": "#e69f00",
    "visual": "#cc79a7",
    "fused": "#009e73",
    "manual": "#56b4e9",
}
"""Line colours of tracks by the source of their poses, as on the web pages."""

DRAWING_COLOURS = {"open": "#6a3d9a", "assigned": "#b15928", "searched": "#1b7837", "line": "#d01c8b"}
"""Line colours of areas by their state, and of other drawings, as on the web pages."""

WIDTH_PX = 3.5
"""Line width of tracks, as on the web pages."""

LEAST_WIDTH_PX, MOST_WIDTH_PX = 1.0, 12.0
MAX_TITLE = 120

COLOUR = r"^#[0-9a-f]{6}\Z"
_ANY_COLOUR = re.compile(r"#?(?:[0-9a-f]{3}|[0-9a-f]{6})")


@dataclass(frozen=True, slots=True)
class TrackLook:
    """What people have set of how a track looks."""

    title: str = ""  # Name to show; empty for that of its source and sender
    colour: str | None = None  # `#rrggbb`; None for that of its source
    width_px: float | None = None  # None for `WIDTH_PX`
    hidden: bool = False  # Whether pages show it only once it is ticked

    def fields(self) -> dict[str, Any] | None:
        """Return the fields that are set; None if none is."""
        return {name: value for name, value in asdict(self).items() if value != getattr(USUAL, name)} or None


USUAL = TrackLook()
"""The look of a track of which nothing is set."""


def look_in_file(title: str, source: str, *, colour: object, width_px: object) -> TrackLook:
    """Return the look that a file gives a track; whatever is invalid or usual is left out.

    Args:
        source: Source of its poses.
        colour: `#rrggbb` or `#rgb`, perhaps without `#` and in capitals.
        width_px: A number, or its text.
    """
    name = texts.tidy_name(title, most=MAX_TITLE) or ""
    if name == source or name.startswith(f"{source}: "):  # our own exports write so what has no title
        name = ""
    written = str(colour or "").strip().lower()
    known = None
    if _ANY_COLOUR.fullmatch(written):
        digits = written.removeprefix("#")
        known = "#" + (digits if len(digits) == 6 else "".join(2 * digit for digit in digits))
    return TrackLook(name, None if known == SOURCE_COLOURS.get(source) else known, _width(width_px))


def _width(width_px: object) -> float | None:
    try:
        width = float(width_px)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    if width == WIDTH_PX or not 0.0 < width < float("inf"):
        return None
    return min(max(width, LEAST_WIDTH_PX), MOST_WIDTH_PX)
