"""Fixtures that many tests share."""

import os
from pathlib import Path

import pytest
from filelock import FileLock

from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks import make_sample


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with real photos for measuring, which is not part of the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real data is not here: {folder}")
    return folder


@pytest.fixture(scope="session")
def sample_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample map, made once for all tests and test processes: nobody may change it."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with FileLock(base / "sample.lock"):
        report = make_sample.run(base / "library" / "sample", settings=Settings(), progress=Progress())
    return report.cfg_path.parent
