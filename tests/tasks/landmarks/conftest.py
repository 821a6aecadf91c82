"""Fixtures of the tests of landmarks."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from filelock import FileLock

from tests.tasks.landmarks.rendered import make_court, truth
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import reconstruct
from webapp.tasks.landmarks.place_rest import suggest_rest

KEYPOINTS = 1000
"""Keypoints per photo: enough for small photos, in half the time."""


@contextmanager
def few_keypoints() -> Iterator[None]:
    """Join photos with fewer keypoints than the program does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reconstruct, "_EXTRACT", replace(reconstruct._EXTRACT, keypoints=KEYPOINTS))
        yield


@pytest.fixture(scope="module", autouse=True)
def quicker() -> Iterator[None]:
    """Join photos with few keypoints in all tests of this folder."""
    with few_keypoints():
        yield


class Court(NamedTuple):
    """A map of the court, and the truth of its photos."""

    cfg: Path
    at: Any
    headings: Any


PHOTOS, PLACED = 9, (0, 4, 8)


@pytest.fixture(scope="session")
def joined_court(common_folder: Path) -> Court:
    """A joined map of nine photos, three of them placed, and one from elsewhere; read-only.

    It is shared by all test processes of a run.
    """
    folder, part = common_folder / "court", common_folder / "court.part"
    with FileLock(common_folder / "court.lock"):
        if not folder.exists():
            cfg, _, _ = make_court(part, photos=PHOTOS, placed=PLACED, alien=True)
            with few_keypoints():
                suggest_rest(cfg, settings=Settings(), progress=Progress())
            part.rename(folder)
    return Court(folder / "map.cfg", *truth(PHOTOS))


@pytest.fixture
def court(joined_court: Court, tmp_path: Path) -> Court:
    """A copy of it that a test may change."""
    folder = tmp_path / "court"
    shutil.copytree(joined_court.cfg.parent, folder)
    return joined_court._replace(cfg=folder / "map.cfg")


@pytest.fixture
def counted() -> Callable[[], Progress]:
    """Make a progress that notes the sizes of stages."""

    class Counted(Progress):
        def __init__(self) -> None:
            self.sizes: list[int] = []

        def size(self, total: int) -> None:
            self.sizes.append(total)

    return Counted
