"""Opens a map and calibrates it: all that happens before the first photo is localized."""

from __future__ import annotations

from pathlib import Path

from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import calibrate, open_map, orient_map
from webapp.tasks.localize.open_map import OpenOptions
from webapp.tasks.localize.photo import PhotoLocalizer


def run(
    cfg: Path,
    options: OpenOptions,
    *,
    settings: Settings,
    progress: Progress,
    fov_deg: float | None = None,
) -> PhotoLocalizer:
    """Make a map ready: index and orientations brought up to date, probabilities calibrated.

    Parameters
    ----------
    cfg : Path
    options : OpenOptions
    settings : Settings
    progress : Progress
    fov_deg : float, optional
        Horizontal field of view of the queries, instead of what their EXIF says.

    Raises
    ------
    MapError, UsageError, StorageError, IndexDamaged, Cancelled
    """
    opened = open_map.run(cfg, options, settings=settings, progress=progress)
    if opened.method == "vote":
        return PhotoLocalizer(opened, settings)
    opened = orient_map.run(opened, map_fov_deg=options.map_fov_deg, progress=progress)
    stored = calibrate.run(opened, map_fov_deg=options.map_fov_deg, progress=progress)
    return PhotoLocalizer(opened, settings, stored, fov_deg)
