"""Fixtures that many tests share."""

import gc
import hashlib
import os
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

# Like the command, before the libraries are loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import hypothesis
import numpy as np
import pytest
from filelock import FileLock

import webapp
from tests.names_failures import NamesFailures
from webapp.extras import EXTRAS
from webapp.progress import Progress
from webapp.sample import make as make_sample
from webapp.settings import Settings
from webapp.store.library import INNER, SERVER, Library, open_library
from webapp.tasks.localize.build_map import build_map
from webapp.tasks.localize.plan import OpenOptions

if TYPE_CHECKING:
    from tests.postgresql_server import PostgresqlServer
    from tests.s3_server import S3Server

# Shells start background processes with SIGINT ignored, which tested commands would inherit.
signal.signal(signal.SIGINT, signal.default_int_handler)

# With Python's default thresholds, a quarter of the time of page tests is spent in garbage collection.
gc.set_threshold(20_000, 50, 100)

# Time limits and random examples would make tests fail by chance. `make fuzz` searches for new ones; those
# found are kept as `@example`.
hypothesis.settings.register_profile(
    "suite",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.register_profile("fuzz", max_examples=1000, deadline=None, print_blob=True)
hypothesis.settings.load_profile("suite")


OUTDATED_AFTER_S = 86_400

TESTS_WORTH = {
    "test_map_kinds": 320,
    "test_plain_install": 280,
    "test_serve_command": 230,
    "test_build_interrupted": 220,
    "test_panorama_map": 180,
    "test_on_demand": 150,
    "test_orient_map": 130,
    "test_localize_sample": 120,
    "test_adjust": 110,
    "test_localize_command": 100,
    "test_make_sample": 90,
    "test_place_rest": 80,
    "test_localize_by_landmarks": 30,
}
"""Files with long tests: their duration in units of a usual file."""


def pytest_configure(config: pytest.Config) -> None:
    """Register the plugin that reports failed tests at once."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        config.pluginmanager.register(NamesFailures(config))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option to run the tests of records on PostgreSQL."""
    parser.addoption(
        "--database",
        choices=("sqlite", "postgresql"),
        default=os.environ.get("EXPMAP_TEST_DATABASE", "sqlite"),
        help="What libraries of tests keep their records in.",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest files first, so that no process has one of them left at the end."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    tests = Counter(item.path for item in items)
    items.sort(key=lambda item: (-TESTS_WORTH.get(item.path.stem, tests[item.path]), item.path))


@pytest.fixture(scope="session")
def postgresql() -> Iterator["PostgresqlServer"]:
    """A PostgreSQL server."""
    from tests.postgresql_server import PostgresqlServer  # loads a driver that most tests do not need

    server = PostgresqlServer()
    yield server
    server.remove()


@pytest.fixture(scope="session")
def s3_process() -> Iterator["S3Server"]:
    """An S3 server, with a proxy that can fail."""
    from tests.s3_server import S3Server  # loads packages that most tests do not need

    server = S3Server()
    yield server
    server.stop()


@pytest.fixture
def s3(s3_process: "S3Server", monkeypatch: pytest.MonkeyPatch) -> Iterator["S3Server"]:
    """The S3 server, reset to work properly; the program gets it from the environment."""
    from tests.s3_server import CREDENTIALS

    for name, value in {**CREDENTIALS, "AWS_ENDPOINT_URL": s3_process.address}.items():
        monkeypatch.setenv(name, value)
    s3_process.reset()
    yield s3_process
    s3_process.silent.clear()
    s3_process.reset()


@pytest.fixture
def database_url(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str | None]:
    """The address of a new database for the test, with all tables; None for SQLite.

    Commands and servers that the test starts get it from the environment.
    """
    if request.config.getoption("--database") == "sqlite":
        yield None
        return
    server = request.getfixturevalue("postgresql")
    url = server.new_database()
    monkeypatch.setenv("EXPMAP_DATABASE", url)
    yield url
    server.drop(url)


@pytest.fixture
def postgresql_only(database_url: str | None) -> None:
    """Skip the test unless records are in PostgreSQL."""
    if database_url is None:
        pytest.skip("about PostgreSQL: --database postgresql")


@pytest.fixture
def sqlite_only(database_url: str | None) -> None:
    """Skip the test unless records are in SQLite."""
    if database_url is not None:
        pytest.skip("about SQLite")


@pytest.fixture
def new_library(database_url: str | None, library_folder: Path) -> Iterator[Callable[[Path], Library]]:
    """Make and open a library in a new folder, with copied tables."""
    opened = []

    def make(folder: Path) -> Library:
        if database_url is None:
            shutil.copytree(library_folder, folder)
        else:
            (folder / INNER).mkdir(parents=True)
            (folder / INNER / SERVER).write_text("a server for tests\n", "utf-8")
        opened.append(open_library(folder, url=database_url))
        return opened[-1]

    yield make
    for library in opened:
        library.database.close()


@pytest.fixture(scope="session")
def library_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a new library, for copies: creating its tables takes a while."""
    folder = tmp_path_factory.mktemp("new") / "library"
    open_library(folder).database.close()
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with real photos for measurements, which is not part of the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real data is not here: {folder}")
    return folder


@pytest.fixture(scope="session")
def shared_models() -> Path:
    """The folder with real weights of networks, which is not part of the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "models"
    if not folder.is_dir():
        pytest.skip(f"the weights are not here: {folder}")
    return folder


@pytest.fixture(scope="session")
def common_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder shared by all test processes of a run."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session")
def kept_folder(pytestconfig: pytest.Config) -> Path:
    """A folder for slow computations: later runs reuse it until the program changes."""
    digest = hashlib.sha256(sys.version.encode())
    for package in ("numpy", "opencv-python-headless", "pillow"):
        digest.update(version(package).encode())
    root = Path(webapp.__file__).parent
    for path in sorted(
        path for path in root.rglob("*") if path.is_file() and path.suffix not in (".pyc", ".po", ".mo")
    ):
        digest.update(f"{path.relative_to(root)} ".encode() + path.read_bytes())
    cache: pytest.Cache = pytestconfig.cache
    name = f"computed-{digest.hexdigest()[:16]}"
    folder = cache.mkdir(name)
    for other in folder.parent.glob("computed-*"):
        if other != folder and other.stat().st_mtime < time.time() - OUTDATED_AFTER_S:
            shutil.rmtree(other, ignore_errors=True)
    return folder


@pytest.fixture(scope="session")
def sample_folder(common_folder: Path, kept_folder: Path) -> Path:
    """The sample map, made once for all tests and test processes; read-only."""
    folder = common_folder / "library" / "sample"
    with FileLock(kept_folder / "sample.lock"):
        make_sample.make_sample(kept_folder / "sample", settings=Settings(), progress=Progress())
        _copy_once(kept_folder / "sample", folder)
    return folder


@pytest.fixture(scope="session")
def ready_sample(common_folder: Path, sample_folder: Path, kept_folder: Path) -> Path:
    """The same with its index and calibration; read-only, but copies can be used at once."""
    folder = common_folder / "ready" / "sample"
    kept = kept_folder / "ready" / "sample"
    with FileLock(kept_folder / "ready.lock"):
        if not (kept_folder / "ready.done").exists():
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(sample_folder, kept, ignore=shutil.ignore_patterns("derived"))
            build_map(kept / "map.cfg", OpenOptions(jobs=1), settings=Settings(), progress=Progress())
            (kept_folder / "ready.done").touch()
        _copy_once(kept, folder)
    return folder


def _copy_once(kept: Path, folder: Path) -> None:
    """Copy the folder for this run, so that tests that change it do not affect later runs."""
    if not folder.exists():
        part = folder.with_name(f"{folder.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(kept, part)
        part.rename(folder)


def textured(seed: int, *, width: int = 320, height: int = 240) -> np.ndarray:
    """Return a picture (height, width) uint8 with structure of all sizes, different for each seed."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((height, width), np.float32)
    for size in (5, 11, 23, 47):
        coarse = rng.normal(size=(height // size + 2, width // size + 2)).astype(np.float32)
        picture += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) * size**0.4
    return cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


@pytest.fixture(scope="session")
def save_photo() -> Callable[[Path, int], None]:
    """Write a small photo; each seed gives another place."""

    def save(path: Path, seed: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(path.suffix, textured(seed))
        assert done
        path.write_bytes(data.tobytes())

    return save


@pytest.fixture(scope="session")
def make_map(save_photo: Callable[[Path, int], None]) -> Callable[[Path, int], Path]:
    """Make a small map of photos in a row, 100 map pixels apart, and return its .cfg."""

    def make(folder: Path, photos: int) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        width = 100 * photos + 100
        cv2.imwrite(str(folder / "plan.png"), np.full((200, width), 200, np.uint8))
        lines = [f"plan.png;{width};200"]
        for number in range(photos):
            save_photo(folder / "photos" / f"{number}.jpg", number)
            lines.append(f"{number};photos/{number}.jpg;{100 * number + 100};100")
        cfg = folder / "map.cfg"
        cfg.write_text("\n".join(lines) + "\n")
        return cfg

    return make


@pytest.fixture
def absent(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make the packages of an extra impossible to import."""

    def take_away(extra: str) -> None:
        loaded = [name for name in sys.modules if name.partition(".")[0] in EXTRAS[extra]]
        for name in {*loaded, *EXTRAS[extra]}:
            monkeypatch.setitem(sys.modules, name, None)

    return take_away
