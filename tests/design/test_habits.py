"""Files for contributors, forges and containers agree with the project."""

import os
import re
import shutil
import stat
import subprocess
import sys

import pytest
import yaml

from webapp import __version__


@pytest.fixture(scope="module")
def targets(project):
    """Return the targets of make."""
    return set(re.findall(r"^([a-z-]+):", (project / "Makefile").read_text("utf-8"), flags=re.MULTILINE))


def load(path):
    return yaml.safe_load(path.read_text("utf-8"))


def test_the_citation_names_this_version(project):
    citation = load(project / "CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    assert (citation["version"], citation["license"]) == (__version__, "MIT")
    assert {"message", "title", "authors"} <= citation.keys()


def test_types_are_shipped(project):
    assert (project / "webapp" / "py.typed").is_file()


def test_the_readme_names_this_version(project):
    text = (project / "README.md").read_text("utf-8")
    assert re.findall(r"^Version (\d+\.\d+\.\d+)", text, flags=re.MULTILINE) == [__version__]


def test_the_forge_runs_what_is_run_here(project, targets):
    workflow = load(project / ".github" / "workflows" / "test.yml")
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    ran = [step["run"] for step in steps if "run" in step]
    assert all(line.removeprefix("make ") in targets for line in ran), ran
    assert {"make test", "make test-slow", "make coverage", "make docs"} == set(ran)
    assert all(re.fullmatch(r"actions/[a-z-]+@v\d+", step["uses"]) for step in steps if "uses" in step)
    assert workflow["jobs"]["test"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert workflow["permissions"] == {"contents": "read"}


def test_hooks_before_a_commit_need_no_network(project):
    config = load(project / ".pre-commit-config.yaml")
    assert [repo["repo"] for repo in config["repos"]] == ["local"]
    for hook in config["repos"][0]["hooks"]:
        assert hook["language"] == "system"
        assert hook["entry"].startswith(".venv/bin/")


def instructions(text):
    """Return the instructions of a Dockerfile (name, arguments), continued lines joined."""
    lines = re.sub(r"\\\n\s*", " ", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)).splitlines()
    return [tuple(line.split(maxsplit=1)) for line in lines if line]


def test_the_image_is_pinned_unprivileged_and_watched(project):
    found = instructions((project / ".docker" / "Dockerfile").read_text("utf-8"))
    names = [name for name, _ in found]
    given = dict(found)
    assert names[0] == "FROM" and names.count("FROM") == 1
    assert re.fullmatch(r"python:3\.\d+\.\d+-[a-z-]+", given["FROM"]), "a base with an exact tag"
    assert given["USER"] not in ("root", "0")
    assert names.index("USER") > max(n for n, name in enumerate(names) if name == "RUN")
    assert "/livez" in given["HEALTHCHECK"], "what a new container would not mend is no reason for one"
    assert "/maps" in given["VOLUME"].split() and "EXPMAP_LIBRARY=/maps" in given["ENV"]
    assert "ADD" not in names
    for name, rest in found:
        assert name != "RUN" or "--no-cache-dir" in rest or "pip" not in rest
        for source in rest.split()[:-1] if name == "COPY" else ():
            assert (project / source).exists(), source
    assert given["CMD"].startswith('["expmap", "serve"')


def test_what_is_copied_into_the_image_is_sent_to_the_builder(project):
    ignore = (project / ".docker" / "Dockerfile.dockerignore").read_text("utf-8").split()
    found = instructions((project / ".docker" / "Dockerfile").read_text("utf-8"))
    copied = {source for name, rest in found if name == "COPY" for source in rest.split()[:-1]}
    assert ignore[0] == "*"
    assert {line[1:] for line in ignore if line.startswith("!")} == copied


def test_the_composition_keeps_the_library_and_listens_here_only(project):
    composition = load(project / ".docker" / "compose.yaml")
    (app,) = composition["services"].values()
    build = project / ".docker" / app["build"]["context"]
    assert (build / app["build"]["dockerfile"]).is_file()
    assert all(port.startswith("127.0.0.1:") for port in app["ports"])
    volumes = dict(volume.split(":") for volume in app["volumes"])
    assert "/maps" in volumes.values() and set(volumes) <= set(composition["volumes"])
    assert app["read_only"] and app["cap_drop"] == ["ALL"]


def test_each_part_of_the_suite_is_run_once(project):
    """The folders named by `make test` and `make test-slow` cover all of tests/ without duplicates."""
    text = (project / "Makefile").read_text("utf-8")
    named = re.search(r"^QUICK\s*:= (.+)$", text, re.M)[1].split()
    pages = re.search(r"^PAGES\s*:= (.+)$", text, re.M)[1].split()
    for folder in (*named, *pages):
        assert (project / folder).is_dir(), folder

    def recipe_of(target):
        return re.search(rf"^{target}:.*\n((?:\t.*\n)+)", text, re.M)[1]

    recipe, slow = recipe_of("test"), recipe_of("test-slow")
    assert slow.count("-j 2 cluster ros-test\n") == 1
    assert slow.count("-j 3 $(VENV)/.tested browser ros-install\n") == 1
    assert recipe.count("-j 2 $(VENV)/.tested browser\n") == 1
    assert slow.count("-m slow $(filter-out tests/cluster, $(wildcard tests/*/))") == 1
    assert recipe.count('-m "not slow"') == recipe.count("$(PYTEST)") + recipe.count("$(call twice,")
    assert recipe_of("ros-install").count("ros/install.py") == 1
    assert recipe_of("browser").count("tests/browser/ensure_browser.py") == 1
    for part in ("$(LINT)", "$(QUICK)", "$(SERVER)", "$(REST)", "$(wildcard $(PAGES))", "tests/browser"):
        assert recipe.count(part) == 1, part
    assert slow.count("$(RECORDS)") == recipe_of("cluster").count("$(CLUSTER)") == 1
    assert recipe_of("ros-test").count("ros/run_tests.py") == 1


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize(
    ("first", "second", "runs", "passes"),
    [(0, 9, 1, True), (1, 0, 2, True), (1, 1, 2, False), (3, 0, 1, False), (137, 0, 1, False)],
    ids=["passes", "passes alone", "fails again", "broke off", "was killed"],
)
def test_only_a_run_that_came_to_its_end_is_repeated(project, tmp_path, first, second, runs, passes):
    """What failed of a run that broke off says nothing of the tests after it."""
    stub = tmp_path / "pytest"
    stub.write_text(
        f"#!/bin/sh\necho run >> {tmp_path}/runs\n"
        f'case "$*" in *--last-failed*) exit {second};; *) exit {first};; esac\n'
    )
    stub.chmod(0o755)
    command = ["make", "-s", "-C", project, f"BIN={tmp_path}", "--eval", "try: ; $(call twice,tests)", "try"]
    done = subprocess.run(command, capture_output=True, check=False)
    assert (tmp_path / "runs").read_text().count("run") == runs
    assert (done.returncode == 0) is passes


def test_a_test_that_fails_is_named_at_once(project, tmp_path):
    (tmp_path / "conftest.py").write_text(
        "from tests.names_failures import NamesFailures\n"
        "def pytest_configure(config):\n    config.pluginmanager.register(NamesFailures(config))\n"
    )
    (tmp_path / "test_two.py").write_text("def test_one():\n    assert 0\ndef test_two(missing):\n    pass\n")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        tmp_path,
        tmp_path,
    ]
    environ = {**os.environ, "PYTHONPATH": str(project)}
    done = subprocess.run([*map(str, command)], cwd=tmp_path, env=environ, capture_output=True, text=True)
    before, _, _ = done.stdout.partition(" ERRORS ")
    assert (
        "FAILED test_two.py::test_one (call)\n" in before
        and "FAILED test_two.py::test_two (setup)\n" in before
    )


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_lets_python_keep_what_it_compiles(project, tmp_path):
    (tmp_path / "seen.mk").write_text("seen:\n\t@echo [$${PYTHONDONTWRITEBYTECODE}]\n")
    command = ["make", "--no-print-directory", "-f", "Makefile", "-f", tmp_path / "seen.mk", "seen"]
    environ = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=project, env=environ, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_scripts_can_be_run(project):
    assert (project / ".ci" / "run").stat().st_mode & stat.S_IXUSR
