"""Fixtures of the tests of building and opening a map."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.opening import open_first_look as open_map
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.localize import build_map, extract_photo
from webapp.tasks.localize.open_map import BuildReport
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look
from webapp.tasks.localize.plan import OpenOptions

Build = Callable[..., BuildReport]


@pytest.fixture(scope="session")
def quick() -> Settings:
    """Settings with few keypoints."""
    return Settings(extract=ExtractSettings(max_side_px=320, keypoints=120))


@pytest.fixture(scope="session")
def build(quick: Settings) -> Build:
    """Build the index of a map, for a method without calibration."""

    def run(cfg: Path, *, progress: Progress | None = None, jobs: int = 1, **options: object) -> BuildReport:
        asked = OpenOptions(method="vote", jobs=jobs, **options)
        return build_map.build_map(cfg, asked, settings=quick, progress=progress or Progress()).index

    return run


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the photos whose features were computed."""
    names = []
    describe = extract_photo._describe

    def note(data, content, job):
        names.append(Path(job.photo).name)
        return describe(data, content, job)

    monkeypatch.setattr(extract_photo, "_describe", note)
    return names


@pytest.fixture(scope="session")
def lasting() -> Callable[[Path], dict[str, bytes]]:
    """Read the files of an index except the manifest."""

    def read(folder: Path) -> dict[str, bytes]:
        kinds = (".features", ".ivf", ".codebook")
        return {p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in kinds}

    return read


@pytest.fixture(scope="session")
def edit() -> Callable[[Path, Callable[[list[str]], object]], None]:
    """Change the lines of a map file."""

    def run(cfg: Path, change: Callable[[list[str]], object]) -> None:
        lines = cfg.read_text().splitlines()
        change(lines)
        cfg.write_text("\n".join(lines) + "\n")

    return run


@pytest.fixture(scope="session")
def found(quick: Settings) -> Callable[..., list[tuple[int, float]]]:
    """Return the ids and probabilities of the answer of `vote` for a photo."""

    def run(cfg: Path, photo: Path, **options: object) -> list[tuple[int, float]]:
        asked = OpenOptions(method="vote", jobs=1, **options)
        opened = open_map(cfg, asked, settings=quick, progress=Progress())
        answer = LocalizationPipeline(opened.method, (Look(opened),)).localize(photo, top=9)
        return [(h.experiences[0], h.probability) for h in answer.hypotheses]

    return run
