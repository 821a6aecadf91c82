"""`expmap cluster demo`: everything starts, the other web server replaces a killed one, nothing is left."""

import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import requests

from webapp.cli.demo.proxy import Upstream, in_order
from webapp.extras import EXTRAS, is_installed

ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-m", "webapp", "cluster", "demo"]

pytestmark = pytest.mark.skipif(
    not (is_installed("cluster") and is_installed("demo")) or os.name == "nt",
    reason="the extras `cluster` and `demo` are not installed",
)


def processes():
    """Return all processes: parents and commands by id."""
    words = ["ps", "-A", "-ww", "-o", "pid=,ppid=,stat=,args="]
    rows = (line.split(maxsplit=3) for line in subprocess.check_output(words, text=True).splitlines())
    return {
        int(pid): (int(parent), args[0]) for pid, parent, state, *args in rows if args and state[0] != "Z"
    }


def descendants(pid):
    """Return a process and its descendants."""
    found, table = {pid}, processes()
    while more := {one for one, (parent, _) in table.items() if parent in found} - found:
        found |= more
    return found


def kill(pids):
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.fixture
def demo(ready_sample, tmp_path):
    """The demo with the sample: its process, its output, and a file with its messages."""
    said = tmp_path / "said"
    words = [*COMMAND, "--port", "0", "--map", ready_sample]
    with (
        said.open("wb") as messages,
        subprocess.Popen(words, stdout=subprocess.PIPE, stderr=messages, text=True, cwd=ROOT) as process,
    ):
        try:
            lines = []
            for line in process.stdout:
                lines.append(line)
                if line.startswith("proxy "):
                    break
            assert process.poll() is None and lines, said.read_text()
            yield process, "".join(lines), said
        finally:
            kill(descendants(process.pid))


def csrf(page):
    return re.search(r'name="csrf-token"[^>]*content="([^"]+)"', page)[1]


def test_a_web_server_may_die_and_nothing_is_left_at_the_end(demo, ready_sample):
    process, printed, said = demo
    address = re.search(r"^listening on (\S+)$", printed, re.M)[1]
    link = re.search(r"^sign in: (\S+)$", printed, re.M)[1]
    parts = {name: int(pid) for name, pid in re.findall(r"^(\S.*?) {2,}(\d+)  ", printed, re.M)}
    assert parts.keys() == {
        *("S3", "PostgreSQL", "Dask scheduler", "Dask worker 1", "Dask worker 2"),
        *("web 1", "web 2", "jobs", "proxy"),
    }
    table = processes()
    data = Path(re.search(r"-D (\S+)", table[parts["PostgreSQL"]][1])[1])
    all_of_it = descendants(process.pid)
    assert {*parts.values()} < all_of_it and data.parent.is_dir()

    browser = requests.Session()
    token = re.search(r'name="csrf_token"[^>]*value="([^"]+)"', browser.get(link, timeout=60).text)[1]
    page = browser.post(link, data={"csrf_token": token}, timeout=60)
    assert page.status_code == 200
    headers = {"X-CSRFToken": csrf(page.text)}

    def localize():
        with (ready_sample / "queries" / "query_01.jpg").open("rb") as file:
            return browser.post(
                f"{address}/api/v1/maps/sample/localize", files={"file": file}, headers=headers, timeout=120
            )

    first = localize()
    assert first.status_code == 200, first.text
    assert first.json()["hypotheses"][0]["kind"] == "position"
    answered = first.headers["X-Answered-By"]
    other = ({"web 1", "web 2"} - {answered}).pop()
    kill(descendants(parts[answered]))
    page = browser.get(f"{address}/maps/sample/edit", timeout=60)
    assert (page.status_code, page.headers["X-Answered-By"]) == (200, other)
    second = localize()
    assert (second.status_code, second.headers["X-Answered-By"]) == (200, other)
    places = [answer.json()["hypotheses"] for answer in (first, second)]
    assert places[0] == places[1]

    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 0
    messages = said.read_text()
    assert f"{answered} (process {parts[answered]}) has ended" in messages
    assert not {pid for pid in all_of_it if processes().get(pid) == table.get(pid)} - {process.pid}
    assert not data.parent.exists()
    assert not Path(re.search(r"logs are in (\S+);", messages)[1]).parent.exists()


def test_each_map_stays_with_a_server_and_moves_only_when_it_is_gone():
    servers = [Upstream(f"web {number}", "127.0.0.1", number) for number in (1, 2, 3)]
    maps = [f"map-{number}" for number in range(60)]
    before = {name: in_order(servers, name)[0].name for name in maps}
    assert {*before.values()} == {"web 1", "web 2", "web 3"}
    servers[0].ready = False
    after = {name: in_order(servers, name)[0].name for name in maps}
    assert {name for name in maps if before[name] != after[name]} == {
        name for name in maps if before[name] == "web 1"
    }
    assert in_order(servers, "map-1")[-1].name == "web 1", "asked last, where no other one answers"


@pytest.mark.parametrize("name", ["cluster", "demo"])
def test_a_missing_extra_is_one_line(name):
    code = (
        "import sys; "
        f"sys.modules[{EXTRAS[name][0]!r}] = None; sys.argv = ['expmap', 'cluster', 'demo', '--port', '0']; "
        "from webapp.app.main import main; main(sys.argv[1:])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert (done.returncode, done.stdout) == (4, "")
    (line,) = done.stderr.splitlines()
    assert line.endswith(f"(pip install 'experience-map[{name}]')")


def test_what_cannot_be_used_is_refused(tmp_path):
    (tmp_path / "something").write_text("")
    for options, sentence in (
        (("--folder", tmp_path), "the folder is not empty"),
        (("--map", tmp_path), "there is no map.cfg"),
    ):
        done = subprocess.run([*COMMAND, *options], capture_output=True, text=True, cwd=ROOT, timeout=300)
        assert (done.returncode, done.stdout) == (2, "")
        assert sentence in done.stderr


def test_a_port_that_is_taken_is_refused_before_anything_starts(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        words = [*COMMAND, "--port", str(port), "--folder", str(tmp_path / "demo")]
        done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"expmap: 127.0.0.1:{port}: another program uses this port (stop it")
    assert not (tmp_path / "demo").exists()
