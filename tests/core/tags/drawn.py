"""Photos of printed tags, drawn by known cameras."""

import math

import cv2
import numpy as np

from webapp.core.tags.detect import modules
from webapp.core.tags.pose import PlacedTag, mount_rotation

WIDTH, HEIGHT, FOCAL = 1200, 900, 1000.0
_OVER = 2  # Pixels are averages of so many, squared
_MODULE = 16


def looking(heading, pitch=0.0, roll=0.0):
    """Return the rotation of a camera from the frame of the map; radians."""
    forward = np.array(
        [
            math.sin(heading) * math.cos(pitch),
            -math.cos(heading) * math.cos(pitch),
            -math.sin(pitch),
        ]
    )
    right = np.array([math.cos(heading), math.sin(heading), 0.0])
    sine, cosine = math.sin(roll), math.cos(roll)
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return turned @ np.stack([right, np.cross(forward, right), forward])


def corners_of(tag, at, *, centre, rotation, turned=None):
    """Return the pixels (4, 2) of a mounted tag's corners.

    Args:
        tag: `PlacedTag`, whose corners and position are not used.
        at: (3,) its true position.
        turned: (3, 3) World from tag; as stated if None.
    """
    turned = mount_rotation(tag.mount, tag.heading_rad or 0.0) if turned is None else turned
    own = (at + tag.shape @ turned.T - centre) @ rotation.T
    assert (own[:, 2] > 0.0).all()
    return FOCAL * own[:, :2] / own[:, 2:] + [(WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0]


def tag_at(at, *, heading_deg=0.0, mount="wall", size_m=0.2, sigma_m=0.01, corners=None):
    heading = None if heading_deg is None else math.radians(heading_deg)
    sigma = np.array([sigma_m, sigma_m, 0.05])
    return PlacedTag("", corners, size_m, np.asarray(at, float), sigma, mount, heading)


def photo_of(tags, *, blur_px=0.8, noise=5.0, seed=0):
    """Draw a grey photo of tags: family, id, and corners (4, 2) in pixels."""
    rng = np.random.default_rng(seed)
    big = np.full((HEIGHT * _OVER, WIDTH * _OVER), 150, np.uint8)
    for family, number, corners in tags:
        black = np.pad(modules(family, number), 2)
        picture = np.kron(np.where(black, 10, 245), np.ones((_MODULE, _MODULE))).astype(np.uint8)
        low, high = 2 * _MODULE - 0.5, len(picture) - 2 * _MODULE - 0.5
        source = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        goal = ((corners + 0.5) * _OVER - 0.5).astype(np.float32)
        warp = cv2.getPerspectiveTransform(source, goal)
        size = (WIDTH * _OVER, HEIGHT * _OVER)
        cv2.warpPerspective(picture, warp, size, dst=big, borderMode=cv2.BORDER_TRANSPARENT)
    small = cv2.resize(big, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small.astype(np.float64), (0, 0), blur_px)
    return np.clip(0.8 * blurred + 20.0 + rng.normal(0.0, noise, blurred.shape), 0, 255).astype(np.uint8)
