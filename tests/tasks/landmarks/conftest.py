"""What the tests of landmarks share."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.tasks.landmarks.rendered import make_court
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.place_rest import suggest_rest


class Court(NamedTuple):
    """A map of the court, and the truth about its photos."""

    cfg: Path
    at: Any
    headings: Any


PHOTOS, PLACED = 9, (0, 4, 8)


@pytest.fixture(scope="session")
def joined_court(tmp_path_factory: pytest.TempPathFactory) -> Court:
    """A map of nine photos, three of them placed, and one from elsewhere, joined: nobody may change it."""
    folder = tmp_path_factory.mktemp("court")
    court = Court(*make_court(folder, photos=PHOTOS, placed=PLACED, alien=True))
    suggest_rest(court.cfg, settings=Settings(), progress=Progress())
    return court


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
