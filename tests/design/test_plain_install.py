"""An installation without extras runs the whole web application, and reports missing parts."""

import contextlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
import urllib.request
import venv

import pytest
from PIL import Image

from tests.design.conftest import run
from tests.standin_models import brightest
from webapp.extras import EXTRAS, install_line

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("hatchling") is None or os.name == "nt",
        reason="hatchling, which builds the wheel, is not installed, or the server does not run here",
    ),
]


@pytest.fixture(scope="module")
def plain(project, wheel, tmp_path_factory):
    """The scripts folder of an environment with the wheel and its requirements."""
    folder = tmp_path_factory.mktemp("plain")
    venv.create(folder / "env", with_pip=False)
    scripts = folder / "env" / "bin"
    command = [sys.executable, "-m", "pip", "--python", scripts / "python", "install", "--quiet"]
    # Used modules are compiled on import; compiling all would take most of the time.
    command += ["--no-compile", "--disable-pip-version-check", "-c", project / "constraints.txt", wheel]
    # `make` sets a path of the constraints relative to the project's folder.
    environ = {name: value for name, value in os.environ.items() if "CONSTRAINT" not in name}
    done = subprocess.run(
        [*map(str, command)], cwd=folder, env=environ, capture_output=True, text=True, timeout=900
    )
    if "Connection" in done.stderr and done.returncode:
        pytest.skip(f"no packages can be fetched here: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return scripts


@pytest.fixture(scope="module")
def library(sample_folder, tmp_path_factory):
    """A library with the sample map."""
    folder = tmp_path_factory.mktemp("library")
    shutil.copytree(sample_folder, folder / "sample", ignore=shutil.ignore_patterns("derived"))
    return folder


def failed(*command, cwd, **environment):
    """Run a command that lacks an extra, and return its output."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "EXPMAP"))} | environment
    done = subprocess.run([*map(str, command)], cwd=cwd, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 4, done.stdout + done.stderr
    return done.stderr


def test_no_package_of_an_extra_is_there(plain):
    ask = "import sys; from importlib.util import find_spec; print([n for n in sys.argv[1:] if find_spec(n)])"
    packages = [package for extra in EXTRAS.values() for package in extra]
    assert run(plain / "python", "-c", ask, *packages, cwd=plain).strip() == "[]"


def test_its_size(plain):
    size_mb = sum(path.stat().st_size for path in plain.parent.rglob("*") if path.is_file()) / 1e6
    sys.stdout.write(f"a plain install takes {size_mb:.0f} MB\n")
    assert size_mb < 600


SMALL = """
import sys
from pathlib import Path
from webapp.progress import Progress
from webapp.sample import make
from webapp.settings import Settings

size = make.SampleSize(photos=2, queries=1, width=160, metres_per_pixel=0.5)
make.make_sample(Path(sys.argv[1]), size=size, settings=Settings(), progress=Progress())
"""


def test_it_makes_the_sample(plain, library, tmp_path):
    run(plain / "python", "-c", SMALL, tmp_path / "small", cwd=tmp_path)
    assert (tmp_path / "small" / "map.cfg").read_text().count("photos/") == 2
    there = run(plain / "expmap", "sample", library / "sample", cwd=tmp_path)
    assert there.strip() == str(library / "sample" / "map.cfg")


def test_it_builds_and_localizes(plain, library):
    sample = library / "sample"
    fewer = ["--keypoints", 500, "--json"]  # in half the time
    report = json.loads(run(plain / "expmap", "build", sample / "map.cfg", *fewer, cwd=library))
    assert report["descriptors"] > 10_000
    query = sample / "queries" / "query_02.jpg"
    found = run(plain / "expmap", "localize", sample / "map.cfg", query, *fewer, cwd=library)
    assert json.loads(found)[0]["hypotheses"][0]["probability"] > 0.5


def test_it_serves(plain, library):
    command = [plain / "expmap", "serve", "--port", "0", "--workers", "1", "--library", library]
    with subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, text=True, cwd=library) as server:
        try:
            address = server.stdout.readline().rpartition(" ")[2].strip()
            until, status = time.monotonic() + 60, None
            while status != 200 and time.monotonic() < until:
                time.sleep(0.2)
                with (
                    contextlib.suppress(OSError),
                    urllib.request.urlopen(f"{address}/healthz", timeout=10) as answer,
                ):
                    status = answer.status
            assert status == 200
        finally:
            server.terminate()


def test_what_is_not_installed_is_named_with_the_command_that_installs_it(plain, library):
    (library / "disk.onnx").write_bytes(brightest("disk"))
    (library / "walk.mcap").write_bytes(b"\x89MCAP0\r\n")
    Image.new("RGB", (200, 100)).save(library / "sample" / "image.tif")
    cfg = library / "sample" / "map.cfg"
    model = {"EXPMAP_MODELS": str(library)}
    learned = failed(plain / "expmap", "build", cfg, "--features", "disk", cwd=library, **model)
    assert install_line("learned") in learned
    run(plain / "expmap", "mission", "new", "Walk", "--library", library, cwd=library)
    command = [plain / "expmap", "mission", "import", 1, library / "walk.mcap", "--library", library]
    assert install_line("missions") in failed(*command, cwd=library)
    assert install_line("sfm") in failed(plain / "expmap", "map", "place-rest", cfg, cwd=library)
    image = ["--satellite", library / "sample" / "image.tif", "--geotiff"]
    command = [plain / "expmap", "map", "from-photos", library / "sample" / "photos", *image]
    assert install_line("geotiff") in failed(
        *command, "--output", library / "sample" / "new.cfg", cwd=library
    )
