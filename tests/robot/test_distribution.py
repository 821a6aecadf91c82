"""The client can be installed as a separate distribution, and sends."""

import importlib.util
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("hatchling") is None,
    reason="hatchling, which builds the wheel, is not installed",
)

PROGRAM = """
import importlib.util, sys
from expmap_robot import RobotClient
from expmap_robot.errors import ExpMapError, InputError
url, token, mission = sys.argv[1:]
with RobotClient(url, token, mission=int(mission), spool="spool") as robot:
    for number in range(5):
        robot.pose(50 + number * 1e-3, 14, time_s=number, covariance=[1, 1, 0])
    try:
        robot.pose(91, 14)
    except ExpMapError as error:
        assert type(error) is InputError and error.where == "lat"
    robot.object("car 1", "car", lat=50, lon=14)
    robot.photo("car.jpg", object_id="car 1")
    robot.end()
    assert robot.upload(wait_s=20), robot.status()
installed = {module.partition(".")[0] for module in sys.modules} - sys.stdlib_module_names
print(sorted(installed - {"__main__", "sitecustomize"}), importlib.util.find_spec("webapp"))
"""


def run(*command, cwd):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "EXPMAP", "PIP"))}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=kept, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    words = ("-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT / "webapp" / "robot")
    run(sys.executable, *words, cwd=folder)
    (built,) = folder.glob("experience_map_robot-*.whl")
    return built


def test_it_sends_from_an_environment_with_nothing_else(wheel, site, mission, tmp_path, save_photo):
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    install = ("-m", "pip", "--python", python, "install", "--no-deps", "--no-index", "--quiet", wheel)
    run(sys.executable, *install, "--disable-pip-version-check", cwd=tmp_path)
    save_photo(tmp_path / "car.jpg", 1)
    printed = run(python, "-c", PROGRAM, site.url, site.token, mission, cwd=tmp_path)
    assert printed == "['expmap_robot'] None\n"
    assert site.summary(mission) == {"tracks": [("gps", 5)], "objects": ["car 1"], "photos": 1}
    assert site.poses().times_s.tolist() == [0, 1, 2, 3, 4] and site.state()[2]


def test_it_holds_the_client_and_shares_no_file_with_the_program(wheel):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    modules = {f"expmap_robot/{path.name}" for path in (ROOT / "webapp" / "robot").glob("*.py")}
    assert names == modules | {"expmap_robot/LICENSE", "expmap_robot/py.typed"}
    archive = zipfile.ZipFile(wheel)
    assert archive.read("expmap_robot/errors.py") == (ROOT / "webapp" / "errors.py").read_bytes()
    metadata = next(name for name in archive.namelist() if name.endswith("METADATA"))
    assert "Requires-Dist" not in archive.read(metadata).decode()
