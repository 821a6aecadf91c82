"""Photos of spots of light on a sphere, whose positions in a panorama are known."""

import numpy as np

FOV_DEG = 80.0
SIX = [(60.0 * n, 0.0, 0.0) for n in range(6)]
"""Yaw, pitch and roll of six cameras around the rig."""


def direction(longitude_deg, elevation_deg):
    """Return a direction: x right, y down, z forward."""
    lon, up = np.radians([longitude_deg, elevation_deg])
    return np.array([np.cos(up) * np.sin(lon), -np.sin(up), np.cos(up) * np.cos(lon)])


def to_rig(yaw_deg, pitch_deg, roll_deg):
    """Return the rotation rig from camera, composed of roll, pitch and yaw."""
    (cy, cp, cr), (sy, sp, sr) = (
        turn(np.radians([yaw_deg, pitch_deg, roll_deg])) for turn in (np.cos, np.sin)
    )
    around = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    up = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return around @ up @ about


def photo_of(spots, mounted, *, wide=320, high=260, fov_deg=FOV_DEG, sigma_deg=1.2):
    """Return a camera's photo, (height, width, 3) uint8, of spots in directions (longitude, elevation)."""
    focal = wide / 2.0 / np.tan(np.radians(fov_deg) / 2.0)
    column, row = np.meshgrid(np.arange(wide) - (wide - 1) / 2.0, np.arange(high) - (high - 1) / 2.0)
    rays = np.stack([column, row, np.full_like(column, focal)], -1)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ to_rig(*mounted).T
    light = sum(
        np.exp(-(np.degrees(np.arccos(np.clip(rays @ direction(*spot), -1, 1))) ** 2) / (2 * sigma_deg**2))
        for spot in spots
    )
    return np.repeat(np.clip(20.0 + 230.0 * light, 0, 255)[..., None], 3, -1).round().astype(np.uint8)
