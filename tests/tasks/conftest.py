"""What the tests of building and opening a map share."""

from collections.abc import Callable
from pathlib import Path

import pytest

from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks import build_map
from webapp.tasks.build_index import BuildReport
from webapp.tasks.open_map import OpenOptions

Build = Callable[..., BuildReport]


@pytest.fixture(scope="session")
def quick() -> Settings:
    """Settings with few keypoints."""
    return Settings(extract=ExtractSettings(max_side_px=320, keypoints=120))


@pytest.fixture(scope="session")
def build(quick: Settings) -> Build:
    """Build the index of a map, for the method without calibration."""

    def run(cfg: Path, *, progress: Progress | None = None, jobs: int = 1, **options: object) -> BuildReport:
        asked = OpenOptions(method="vote", jobs=jobs, **options)
        return build_map.run(cfg, asked, settings=quick, progress=progress or Progress()).index

    return run
