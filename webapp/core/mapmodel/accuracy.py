"""Accuracy of the positions of a map's photos."""

from __future__ import annotations

from webapp.core.mapmodel.model import Experience, Map

_GPS_M = 8.0
"""68 % radius of GPS positions without a stated accuracy: phones between buildings."""


def position_radius_px(photo: Experience, the_map: Map) -> float:
    """Return the 68 % radius of a photo's position, map pixels; 0 for one that was placed by hand."""
    if photo.radius_px is not None:
        return photo.radius_px
    if not photo.by_gps or the_map.georeference is None:
        return 0.0
    accuracy_m = _GPS_M if photo.gps_accuracy_m is None else photo.gps_accuracy_m
    return accuracy_m / the_map.georeference.metres_per_pixel(photo.position)


def inexact_positions(the_map: Map) -> dict[int, float]:
    """Return the 68 % radii, map pixels, of the experiences with inexact positions, by id."""
    radii = {photo.id: position_radius_px(photo, the_map) for photo in the_map.experiences}
    return {id: radius for id, radius in radii.items() if radius > 0.0}
