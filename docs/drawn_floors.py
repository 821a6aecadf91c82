"""A building with four floors for the pictures of the documentation: plans, and photos from its windows."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image, ImageDraw

from tests.browser.api import Api

NAME, SLUG = "Pavilion", "pavilion"
SIZE = (1200, 800)
SHOWN = 4
"""A photo of the first floor."""

_IN_TRAY = 4

_FLOORS = (
    ("Ground floor", 0.0, 0.0, "#e3edf5"),
    ("1st floor", 1.0, 4.2, "#f5e9dc"),
    ("2nd floor", 2.0, 8.1, "#e6f2e2"),
    ("Cellar", -1.0, -3.2, "#ececec"),
)
"""Name, level, height and the colour of the rooms."""

_WALLS = (
    ((420, 60, 420, 430), (780, 60, 780, 430), (60, 430, 1140, 430), (600, 430, 600, 740)),
    (
        (340, 60, 340, 330),
        (600, 60, 600, 330),
        (860, 60, 860, 330),
        (60, 330, 1140, 330),
        (600, 480, 600, 740),
    ),
    ((480, 60, 480, 740), (780, 60, 780, 400), (480, 400, 1140, 400)),
    ((340, 60, 340, 740), (860, 60, 860, 740)),
)
_DOORS = (
    ((420, 220), (780, 220), (240, 430), (600, 600), (940, 430)),
    ((340, 200), (600, 200), (860, 200), (220, 330), (720, 330), (600, 610)),
    ((480, 240), (480, 580), (780, 230), (980, 400)),
    ((340, 400), (860, 400)),
)
_WINDOWS = (
    *((180, 100, 20), (470, 100, 340), (730, 100, 10), (1010, 100, 30), (1090, 240, 80)),
    *((1090, 580, 100), (900, 700, 170), (380, 700, 200), (110, 600, 260)),
)
"""Where photos are taken, and where they look: x, y, heading."""

_INK, _STAIRS = "#3a3f44", (1010, 470, 1110, 560)


def plan(floor: int) -> bytes:
    """Draw the plan of a floor; gives a PNG file."""
    image = Image.new("RGB", SIZE, "#fbfaf6")
    draw = ImageDraw.Draw(image)
    draw.rectangle((60, 60, 1140, 740), fill=_FLOORS[floor][3], outline=_INK, width=14)
    for wall in _WALLS[floor]:
        draw.line(wall, fill=_INK, width=9)
    for x, y in _DOORS[floor]:
        draw.rectangle((x - 28, y - 28, x + 28, y + 28), fill=_FLOORS[floor][3])
    for x in range(140, 1100, 160):
        for y in (60, 740):
            draw.line((x - 35, y, x + 35, y), fill="#9ec3d9", width=6)
    left, top, right, bottom = _STAIRS
    draw.rectangle(_STAIRS, fill="#ffffff", outline=_INK, width=4)
    for x in range(left + 12, right, 12):
        draw.line((x, top, x, bottom), fill=_INK, width=2)
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def make_floors(api: Api, sample: Path) -> None:
    """Make a map of the building, with photos of the sample as seen from its windows."""
    photos = sorted((sample / "photos").glob("*.jpg"))[: 4 * len(_WINDOWS)]
    api.make_map(NAME, satellite=None, photos=photos)
    url = f"/maps/{SLUG}"
    api.ask("PUT", f"{url}/satellite", multipart={"file": _png(0)})
    for number in range(1, len(_FLOORS)):
        name, level, height_m, _ = _FLOORS[number]
        wish = {"name": name, "level": str(level), "height_m": str(height_m), "file": _png(number)}
        api.ask("POST", f"{url}/floors", multipart=wish)
    changes = []
    for id in range(len(photos) - _IN_TRAY):
        x, y, heading = _WINDOWS[(id // 4) % len(_WINDOWS)]
        changes.append({"id": id, "x_px": x, "y_px": y, "heading_deg": heading, "floor": (id + 1) % 4})
    api.ask("PATCH", f"{url}/experiences", data={"kind": "place", "changes": changes})
    api.wait_for_jobs(SLUG)


def _png(floor: int) -> dict[str, object]:
    return {"name": f"plan-{floor}.png", "mimeType": "image/png", "buffer": plan(floor)}
