"""Rendered photos of a textured court with known poses."""

from functools import cache

import cv2
import numpy as np

from tests.conftest import textured
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage, UnplacedPhoto
from webapp.files.maps.folder import write_map

SIDE, HEIGHT = 20.0, 8.0
"""Side of the court and height of its walls, metres; it is 400 map pixels wide."""

PIXELS_PER_METRE = 20.0
WIDTH, TALL, FOCAL = 400, 300, 330.0
FOV_DEG = float(np.degrees(2 * np.arctan(WIDTH / 2 / FOCAL)))


def render(x, y, heading):
    """Render a photo at (x, y), metres east and south of a corner, at eye level; heading in radians."""
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(TALL) + 0.5 - TALL / 2)
    sine, cosine = np.sin(heading), np.cos(heading)
    return _trace(x, y, (cosine * column + sine * FOCAL, sine * column - cosine * FOCAL, row))


def render_panorama(x, y, heading, *, wide=1440):
    """Render an equirectangular panorama at a position; its middle has the heading."""
    around, below = np.meshgrid(
        ((np.arange(wide) + 0.5) / wide - 0.5) * 2.0 * np.pi + heading,
        ((np.arange(wide // 2) + 0.5) / (wide // 2) - 0.5) * np.pi,
    )
    level = np.cos(below)
    return _trace(x, y, (level * np.sin(around), -level * np.cos(around), np.sin(below)))


def _trace(x, y, direction):
    """Return the colours seen by rays (east, south, down) from a point."""
    east, south, down = direction
    nearest, picture = np.full(east.shape, np.inf), np.zeros(east.shape, np.float32)
    for number, (along, to, origin) in enumerate(
        [(east, SIDE, x), (east, 0.0, x), (south, SIDE, y), (south, 0.0, y), (down, 1.6, 0.0)]
    ):
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(np.abs(along) > 1e-9, (to - origin) / along, -1.0)
        hit = (far > 0.0) & (far < nearest)
        u, v = x + far * east, y + far * south
        if number < 4:
            u, v = (v if number < 2 else u), far * down + HEIGHT
        surface = _surface(number)
        sampled = cv2.remap(
            surface, (u * 55).astype(np.float32), (v * 55).astype(np.float32), cv2.INTER_LINEAR
        )
        picture, nearest = np.where(hit, sampled, picture), np.where(hit, far, nearest)
    return picture.astype(np.uint8)


@cache
def _surface(number):
    return textured(100 + number, width=1200, height=1200).astype(np.float32)


def walk(photos):
    """Return positions (n, 2), metres, and headings of photos on a path around the middle of the court."""
    step = np.linspace(0.0, 1.0, photos)
    angle = 0.3 + 1.6 * step
    at = np.stack([SIDE / 2 + 4.0 * np.cos(angle), SIDE / 2 + 3.0 * np.sin(angle)], 1)
    return at, angle - np.pi / 2 + 0.4


def make_court(folder, *, photos, placed, alien=False):
    """Make a map of the court: the photos `placed` have positions, the others are in its tray.

    `alien` adds one from elsewhere.
    """
    at, headings = walk(photos)
    (folder / "photos").mkdir(parents=True)
    names = [f"photos/{number:02}.png" for number in range(photos)]
    for name, (x, y), heading in zip(names, at, headings, strict=True):
        cv2.imwrite(str(folder / name), render(x, y, heading))
    if alien:
        names.append("photos/99.png")
        cv2.imwrite(str(folder / names[-1]), textured(5, width=WIDTH, height=TALL))
    cv2.imwrite(str(folder / "plan.png"), np.full((400, 400), 200, np.uint8))
    cfg = folder / "map.cfg"
    write_map(
        cfg,
        Map(
            SatelliteImage("plan.png", 400, 400),
            tuple(
                Experience(n, names[n], MapPixel(*(PIXELS_PER_METRE * at[n])), fov_deg=FOV_DEG)
                for n in placed
            ),
            unplaced=tuple(
                UnplacedPhoto(n, name, fov_deg=FOV_DEG) for n, name in enumerate(names) if n not in placed
            ),
            next_id=len(names),
        ),
    )
    return cfg, *truth(photos)


def truth(photos):
    """Return positions (n, 2) of photos of a walk, map pixels, and headings, degrees."""
    at, headings = walk(photos)
    return PIXELS_PER_METRE * at, np.degrees(headings) % 360.0
