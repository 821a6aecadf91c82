"""Opens the index of a map for the first look of a request, as `open_pipeline` does."""

from pathlib import Path

from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize.open_index import open_index
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.open_pipeline import make_plan
from webapp.tasks.localize.plan import OpenOptions


def open_first_look(cfg: Path, options: OpenOptions, *, settings: Settings, progress: Progress) -> OpenMap:
    """Open it without geometry and calibration."""
    plan = make_plan(cfg, options, settings=settings, newest=True).looks[0]
    return open_index(cfg, plan, the_map=read_map(cfg), settings=settings, progress=progress)
