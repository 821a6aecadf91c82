"""Reads the geometry of a camera rig, and groups the photos that its cameras took at one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from webapp.core.geometry.rig import RigCamera
from webapp.errors import InputError
from webapp.files.json_fields import JsonField, finite, parse_json
from webapp.files.listing import natural_key

_MOST = 64
"""Maximum number of cameras of a rig."""


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """A camera of a rig, and the pattern of its photos' names."""

    photos: str  # Pattern with one `*` for the instant: `left/*.jpg`, `frame_*_left.png`
    # `yaw_deg`, `pitch_deg`, `roll_deg`: See `RigCamera`.
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    fov_deg: float | None  # None to use the EXIF of each photo

    def with_fov(self, fov_deg: float) -> RigCamera:
        """Return its mounting with a field of view."""
        return RigCamera(self.yaw_deg, self.pitch_deg, self.roll_deg, fov_deg)

    def instant(self, name: str) -> str | None:
        """Return the part of a photo's name that identifies the instant; None if it is not this camera's."""
        before, after = self.photos.split("*")
        if not name.startswith(before) or not name.endswith(after) or len(name) <= len(before + after):
            return None
        found = name[len(before) : len(name) - len(after)]
        return None if "/" in found else found


def read_rig(path: Path) -> tuple[MountedCamera, ...]:
    """Read the file of a rig.

    Raises:
        InputError: The file cannot be read.
        MapJsonError: Its content is invalid.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", where=str(path)) from error
    field = parse_json(data, where=str(path)).record(required=["cameras"])["cameras"]
    cameras = tuple(_camera(item) for item in field.items())
    if not 1 <= len(cameras) <= _MOST:
        raise field.error(f"has {len(cameras)} cameras", hint=f"name 1 to {_MOST}")
    if len({camera.photos for camera in cameras}) < len(cameras):
        raise field.error("has two cameras with the same photos", hint="give each camera photos of its own")
    return cameras


def _camera(item: JsonField) -> MountedCamera:
    fields = item.record(required=["photos", "yaw_deg"], optional=["pitch_deg", "roll_deg", "fov_deg"])
    photos = fields["photos"].text()
    if photos.count("*") != 1:
        raise fields["photos"].error("needs one * for the instant", hint="as in left/*.jpg")

    def angle(name: str, most: float) -> float:
        if fields[name].missing:
            return 0.0
        return fields[name].number(
            f"from {-most:g} to {most:g} degrees", valid=lambda value: finite(value) and abs(value) <= most
        )

    fov = None
    if not fields["fov_deg"].missing:
        fov = fields["fov_deg"].number("from 1 to 170 degrees", valid=lambda value: 1.0 <= value <= 170.0)
    return MountedCamera(
        photos, angle("yaw_deg", 360.0), angle("pitch_deg", 90.0), angle("roll_deg", 360.0), fov
    )


def photos_by_instant(
    cameras: Sequence[MountedCamera], names: Sequence[str]
) -> Mapping[str, tuple[str | None, ...]]:
    """Group photos by the instant in their names, in natural order; one name or None per camera."""
    found: dict[str, list[str | None]] = {}
    for number, camera in enumerate(cameras):
        for name in names:
            instant = camera.instant(name)
            if instant is not None:
                found.setdefault(instant, [None] * len(cameras))[number] = name
    return {instant: tuple(found[instant]) for instant in sorted(found, key=natural_key)}
