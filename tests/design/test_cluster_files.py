"""The files for several machines agree with the program: Compose, systemd units, proxies."""

import re
import shlex
import tomllib
from configparser import ConfigParser

import pytest
import yaml

from webapp.app.main import root
from webapp.configuration import settings_table

_OPTIONS = {
    "Unit": {"Description", "After", "Wants", "RequiresMountsFor"},
    "Service": {
        *("User", "ExecStart", "Environment", "EnvironmentFile", "Restart", "KillMode", "TimeoutStopSec"),
        *("UMask", "NoNewPrivileges", "ProtectSystem", "ReadWritePaths", "PrivateTmp", "StandardOutput"),
        "CacheDirectory",
    },
    "Install": {"WantedBy"},
}
"""Options of systemd that are used."""

VARIABLES = {name for setting in settings_table().values() for name in setting.variables}


@pytest.fixture(scope="module")
def page(project):
    return (project / "docs" / "cluster.md").read_text("utf-8")


@pytest.fixture(scope="module")
def compose(project):
    return yaml.safe_load((project / ".docker" / "cluster.yaml").read_text("utf-8"))


def test_the_image_is_built_from_everything_that_the_wheel_holds(project):
    """Else `pip install .` in the container leaves pages or the manual out, and says nothing."""
    table = tomllib.loads((project / "pyproject.toml").read_text("utf-8"))
    parts = {
        *table["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"],
        "pyproject.toml",
        "README.md",
    }
    docker = project / ".docker"
    ignored = (docker / "Dockerfile.dockerignore").read_text("utf-8").split()
    copied = re.findall(r"^COPY (.+) \S+$", (docker / "Dockerfile").read_text("utf-8"), re.M)
    assert {f"!{part}" for part in parts} <= set(ignored)
    assert parts <= {part for line in copied for part in line.split()}


def blocks(page, begin):
    """Return the code blocks that begin with something."""
    return [
        block for block in re.findall(r"^```\w*\n(.*?)^```$", page, re.M | re.S) if block.startswith(begin)
    ]


def unit(text):
    """Return a systemd unit: {section: {option: value}}."""
    parser = ConfigParser(interpolation=None, delimiters="=", strict=True)
    parser.optionxform = str
    parser.read_string(text)
    return {name: dict(parser[name]) for name in parser.sections()}


def check_command(words):
    """Check that `expmap` or `dask` has the command, and `expmap` its options."""
    program, name, *rest = words
    assert program.rpartition("/")[2] in ("expmap", "dask")
    if program.endswith("dask"):
        assert name in ("scheduler", "worker")
        return
    known = {option for one in root.get_command(None, name).params for option in one.opts}
    assert {word for word in rest if word.startswith("--")} <= known


def seconds(text):
    return float(text.removesuffix("s"))


_WORKER = "MALLOC_ARENA_MAX=1"
"""Environment of a Dask worker; see "Computing on other machines"."""


def test_the_services_of_systemd(project, page):
    units = [unit(text) for text in blocks(page, "[Unit]")]
    units += [unit(text) for text in blocks((project / "docs" / "install.md").read_text("utf-8"), "[Unit]")]
    assert len(units) == 4
    for one in units:
        for section, options in one.items():
            assert options.keys() <= _OPTIONS[section], section
        service = one["Service"]
        if "ExecStart" in service:
            check_command(shlex.split(service["ExecStart"]))
            computes = " worker tcp://" in service["ExecStart"]
            assert (service.get("Environment") == _WORKER) == computes
            assert (service["User"], service["ProtectSystem"]) == ("expmap", "strict")
            assert service["NoNewPrivileges"] == service["PrivateTmp"] == "true"
        for setting in service.get("Environment", "").split():
            assert setting.partition("=")[0] in VARIABLES or setting == _WORKER


def test_a_service_has_time_to_drain(page):
    (drop_in,) = [
        one["Service"] for one in map(unit, blocks(page, "[Unit]")) if "ExecStart" not in one["Service"]
    ]
    given = dict(text.split("=") for text in drop_in["Environment"].split())
    defaults = settings_table()
    needed = float(given["EXPMAP_SERVE_DRAIN_S"]) + defaults["serve.stop_s"].default
    assert seconds(drop_in["TimeoutStopSec"]) > needed
    assert drop_in["KillMode"] == "mixed", "else all get the signal at once"


def test_the_composition_of_several_servers(project, compose):
    services = compose["services"]
    assert services.keys() == {"web-1", "web-2", "jobs", "scheduler", "dask-worker", "database", "proxy"}
    ports = [port for one in services.values() for port in one.get("ports", ())]
    assert ports and all(port.startswith("127.0.0.1:") for port in ports)
    for name, one in services.items():
        if "build" not in one:
            assert re.fullmatch(r"[a-z]+(/[a-z]+)?:\d+\.\d+[\w.-]*", one["image"]), "an exact version"
            continue
        assert (project / ".docker" / one["build"]["context"] / one["build"]["dockerfile"]).is_file()
        assert one["read_only"] and one["cap_drop"] == ["ALL"], name
        assert {volume.split(":")[0] for volume in one["volumes"]} <= compose["volumes"].keys()
        assert {key for key in one["environment"] if key.startswith("EXPMAP_")} <= VARIABLES
        drained = float(one["environment"]["EXPMAP_SERVE_DRAIN_S"])
        assert seconds(one["stop_grace_period"]) > drained + settings_table()["serve.stop_s"].default
        assert ("MALLOC_ARENA_MAX" in one["environment"]) == (name == "dask-worker")
        command = one.get("command", "expmap serve")
        check_command(shlex.split(command) if isinstance(command, str) else command)
    assert all("command" not in services[name] for name in ("web-1", "web-2")), "that of the image"


def test_the_image_can_have_other_extras(project, compose):
    extras = compose["services"]["web-1"]["build"]["args"]["EXTRAS"]
    text = (project / ".docker" / "Dockerfile").read_text("utf-8")
    assert "ARG EXTRAS=all\n" in text and '".[${EXTRAS}]"' in text
    assert set(extras.split(",")) == {"all", "cluster"}


def test_the_image_of_the_ros_nodes_copies_what_there_is(project):
    """It was not built: there are no images of ROS here. So what it copies and starts is checked as text."""
    text = (project / ".docker" / "ros.Dockerfile").read_text("utf-8")
    copied = [path for line in re.findall(r"^COPY (.+)$", text, re.M) for path in line.split()[:-1]]
    assert copied and all((project / path).exists() for path in copied)
    ignored = (project / ".docker" / "ros.Dockerfile.dockerignore").read_text("utf-8").splitlines()
    assert {line[1:] for line in ignored if line.startswith("!")} == set(copied)
    (package, node) = re.search(r'CMD \["ros2", "run", "(\w+)", "(\w+)"\]', text).groups()
    assert f'name="{package}"' in (project / "ros" / package / "setup.py").read_text("utf-8")
    assert f'"{node}"' in (project / "ros" / package / "setup.py").read_text("utf-8")
    client = (project / "webapp/robot/pyproject.toml").read_text("utf-8")
    needed = re.findall(r'"((?:\.\./)+\S+)"', client)  # relative to webapp/robot
    held = {(project / "webapp/robot" / path).resolve().relative_to(project).as_posix() for path in needed}
    assert held <= set(copied)


def test_both_files_for_caddy_say_the_same(page, compose):
    (block,) = blocks(page, "maps.example.org {")
    inner = compose["configs"]["caddy"]["content"]
    ours, theirs = ([line.strip() for line in text.splitlines()][1:] for text in (block, inner))
    servers = "reverse_proxy 10.0.0.11:8000 10.0.0.12:8000 {"
    assert [line.replace(servers, "reverse_proxy web-1:8000 web-2:8000 {") for line in ours] == theirs


@pytest.mark.parametrize("path", ["/maps/park/edit", "/api/v1/maps/park/localize", "/missions/7", "/account"])
def test_both_proxies_know_the_map_of_a_request(page, path):
    (nginx,) = blocks(page, "map $uri")
    (caddy,) = blocks(page, "maps.example.org {")
    one = re.search(re.search(r"~(\S+) \$name", nginx)[1].replace("(?<", "(?P<"), path)
    other = re.search(re.search(r"@map path_regexp map (\S+)", caddy)[1], path)
    assert (one and one["name"]) == (other and other[1])
    assert (one is None) == (path == "/account")
