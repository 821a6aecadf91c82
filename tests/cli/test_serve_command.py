"""`expmap serve` and `expmap worker` as processes: started, stopped and killed."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from tests.ports import reserved_port
from webapp.jobs.webserver import gunicorn_options
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.schema import Job

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the server does not run natively on Windows")


def new_library(path):
    """Make a library with an owner and a map, so that the start creates nothing."""
    library = open_library(path)
    with library.database.write() as session:
        maps.create(session, "Park", account_id=accounts.ensure_owner(session).id)
    library.database.close()
    return library.folder


@pytest.fixture
def folder(tmp_path):
    return new_library(tmp_path / "library")


@pytest.fixture
def port():
    with reserved_port() as port:
        yield port


def command(folder, *options):
    return [sys.executable, "-m", "webapp", "serve", "--library", str(folder), "--workers", "1", *options]


@contextmanager
def served(folder, port):
    """Serve a library and return the process, its address and the link to sign in."""
    words = command(folder, "--port", str(port))
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT) as server:
        try:
            listening = re.fullmatch(r"listening on (http://\S+)\n", server.stdout.readline())
            link = re.fullmatch(r"sign in: (http://\S+)\n", server.stdout.readline())
            yield server, listening[1], link[1]
        finally:
            server.send_signal(signal.SIGTERM)
            try:
                server.wait(60)
            finally:
                for pid in processes(folder):
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)


def processes(folder, what=""):
    """Return the ids of the processes of a library with those of their parents."""
    table = subprocess.run(
        ["ps", "-A", "-ww", "-o", "pid=,ppid=,stat=,args="], capture_output=True, text=True
    )
    rows = [line.split(maxsplit=3) for line in table.stdout.splitlines()]
    return {
        int(pid): int(parent)
        for pid, parent, state, args in rows
        if str(folder) in args and what in args and not state.startswith("Z")
    }


def web(folder):
    """Return the ids of gunicorn's master and its workers."""
    all_ = processes(folder, "webapp.jobs.webserver")
    masters = [pid for pid, parent in all_.items() if parent not in all_]
    return masters[0] if masters else None, [pid for pid in all_ if pid not in masters]


def answers(url):
    """Return whether a web process responds."""
    try:
        with urllib.request.urlopen(url + "/sign-in", timeout=60) as response:
            return response.status == 200
    except (OSError, urllib.error.URLError):
        return False


def wait_for(happened, *, seconds=60.0):
    until = time.monotonic() + seconds
    while not (found := happened()):
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.05)
    return found


def test_it_says_where_it_is_and_stops_on_ctrl_c(folder, port):
    with served(folder, port) as (server, url, link):
        assert url == f"http://127.0.0.1:{port}"
        assert link.startswith(f"{url}/sign-in/")
        assert answers(url)
        assert urllib.request.urlopen(link, timeout=60).status == 200
        assert len(processes(folder)) == 5
        background, _ = processes(folder, "webapp worker")
        assert os.getpriority(os.PRIO_PROCESS, background) > os.getpriority(os.PRIO_PROCESS, server.pid)
        if (group := Path(f"/proc/{background}/autogroup")).exists():
            assert group.read_text().endswith(" nice 5\n")
        server.send_signal(signal.SIGINT)
        assert server.wait(60) == 0
        assert server.stdout.read() == ""
        assert not processes(folder)
        assert not answers(url)


def failing_health(url):
    try:
        urllib.request.urlopen(url + "/healthz", timeout=60).close()
    except urllib.error.HTTPError as error:
        with error:
            return json.loads(error.read())["status"]


def answers_quickly(url):
    try:
        return urllib.request.urlopen(url + "/livez", timeout=0.5).status == 200
    except OSError:
        return False


def test_it_says_that_it_is_not_ready_finishes_its_requests_and_ends(folder, port, monkeypatch):
    monkeypatch.setenv("EXPMAP_SERVE_DRAIN_S", "600")
    monkeypatch.setenv("EXPMAP_SERVE_STOP_S", "60")
    monkeypatch.setenv("EXPMAP_SERVE_JOB_WORKERS", "0")
    with served(folder, port) as (server, url, _), socket.create_connection(("127.0.0.1", port)) as slow:
        assert json.loads(urllib.request.urlopen(url + "/healthz", timeout=60).read()) == {
            "status": "ok",
            "web": "ok",
            "database": "ok",
            "disk": "ok",
        }
        assert not processes(folder, "webapp worker")
        slow.sendall(
            b"POST /sign-in HTTP/1.1\r\nHost: here\r\nContent-Length: 9\r\nConnection: close\r\n\r\nname"
        )
        server.send_signal(signal.SIGTERM)
        wait_for(lambda: failing_health(url) == "draining")
        assert urllib.request.urlopen(url + "/livez", timeout=60).status == 200
        assert urllib.request.urlopen(url + "/sign-in", timeout=60).status == 200
        server.send_signal(signal.SIGTERM)  # no need to wait longer
        wait_for(lambda: not answers_quickly(url))
        slow.sendall(b"=jana")
        slow.settimeout(60)
        assert slow.makefile("rb").readline() == b"HTTP/1.1 400 BAD REQUEST\r\n"
        assert server.wait(60) == 0
        assert not processes(folder)


@pytest.mark.slow
def test_killed_processes_are_replaced(folder, port):
    with served(folder, port) as (server, url, _):
        master, (worker,) = web(folder)
        background, _ = processes(folder, "webapp worker")
        os.kill(worker, signal.SIGKILL)
        wait_for(lambda: web(folder)[1] not in ([], [worker]))
        wait_for(lambda: answers(url))
        assert web(folder)[0] == master
        os.kill(background, signal.SIGKILL)
        wait_for(lambda: len(processes(folder, "webapp worker").keys() - {background}) == 2)
        os.kill(master, signal.SIGKILL)
        # The supervisor holds the socket: connections wait instead of being refused.
        assert answers(url)
        wait_for(lambda: web(folder)[0] not in (None, master))
        assert server.poll() is None


@pytest.mark.slow
def test_without_the_supervisor_all_end_and_the_next_can_start(folder, port):
    with served(folder, port) as (server, _, _):
        wait_for(lambda: len(processes(folder)) == 5)
        orphans = processes(folder).keys() - {server.pid}
        server.kill()
        server.wait()
        if sys.platform == "linux":  # they do not hold the port
            with socket.create_server(("127.0.0.1", port)):
                pass
        with served(folder, port) as (_, url, _):
            assert answers(url)
            wait_for(lambda: not orphans & processes(folder).keys())
            wait_for(lambda: len(processes(folder)) == 5)


@pytest.mark.slow
def test_web_processes_end_at_once_with_the_supervisor_even_in_a_request(folder, port, monkeypatch):
    monkeypatch.setenv("EXPMAP_SERVE_PATIENCE_S", "600")
    with served(folder, port) as (server, url, _), socket.create_connection(("127.0.0.1", port)) as slow:
        slow.sendall(
            b"POST /sign-in HTTP/1.1\r\nHost: here\r\nContent-Length: 9\r\n"
            b"Content-Type: application/x-www-form-urlencoded\r\n\r\nname"
        )
        assert answers(url)
        server.kill()
        slow.settimeout(60)
        with suppress(ConnectionResetError):
            assert slow.recv(1) == b""
        wait_for(lambda: not web(folder)[1])


def test_a_port_in_use(folder, port):
    with socket.create_server(("127.0.0.1", port)):
        done = subprocess.run(
            command(folder, "--port", str(port)), capture_output=True, text=True, cwd=ROOT, timeout=300
        )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        f"expmap: 127.0.0.1:{port}: another program uses this port "
        f"(stop it, or choose another port: --port {port + 1})"
    ]


def test_an_unknown_host(folder):
    done = subprocess.run(
        command(folder, "--host", "256.0.0.1"), capture_output=True, text=True, cwd=ROOT, timeout=300
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "cannot listen there" in done.stderr.splitlines()[-1]


def test_below_a_path_it_does_not_start(folder, monkeypatch):
    monkeypatch.setenv("SCRIPT_NAME", "/maps")
    done = subprocess.run(command(folder), capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        "expmap: Experience Map cannot be served below a path (/maps) "
        "(unset SCRIPT_NAME, and give the server a host name or a port of its own)"
    ]


@pytest.mark.slow
def test_an_application_that_does_not_start_is_given_up(folder):
    text = (
        "import sys; from pathlib import Path\n"
        "from webapp.jobs import serving; from webapp.settings import Settings\n"
        "site = serving.Site('webapp.nowhere:create_app', '127.0.0.1', 0, 1)\n"
        "serving.serve(site, settings=Settings(library=Path(sys.argv[1])), echo=print)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", text, folder], capture_output=True, text=True, cwd=ROOT, timeout=300
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert "No module named 'webapp.nowhere'" in done.stderr
    assert "the web server did not start" in done.stderr.splitlines()[-1]
    assert not processes(folder)


@pytest.mark.skipif(
    not Path("/proc/self/maps").exists(), reason="the loaded libraries are listed on Linux only"
)
def test_who_forks_has_not_loaded_opencv(folder, port):
    def loaded(pid):
        return {
            name for name in ("cv2", "faiss", "numpy") if f"/{name}" in Path(f"/proc/{pid}/maps").read_text()
        }

    with served(folder, port) as (server, _, _):
        master, (worker,) = web(folder)
        assert "cv2" in loaded(worker)
        assert loaded(master) == loaded(server.pid) == set()


@pytest.mark.slow
def test_the_first_start_has_a_sample_map(tmp_path, port, sample_folder):
    shutil.copytree(sample_folder, tmp_path / "maps" / "sample")  # making it takes long
    with served(tmp_path / "maps", port) as (_, _, _):
        library = open_library(tmp_path / "maps")
        with library.database.read() as session:
            (account,) = accounts.list_accounts(session)
            (record,) = maps.list_maps(session, account)
            assert (record.slug, maps.counts(session, record)) == ("sample", (60, 60))
            assert account.is_owner
        library.database.close()


def test_the_worker_alone_does_what_waits(folder):
    library = open_library(folder)
    with library.database.write() as session:
        id = jobs.enqueue(session, "index", map_id=1).id
    words = [sys.executable, "-m", "webapp", "worker", "--library", str(folder), "--once"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert (done.returncode, done.stdout) == (0, "")
    with library.database.read() as session:
        assert session.get(Job, id).state == "failed"  # the map has no image
    library.database.close()


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_worker_has_a_process_for_short_jobs_that_ends_with_it(folder, how):
    words = [sys.executable, "-m", "webapp", "worker", "--library", str(folder)]
    with subprocess.Popen(words, cwd=ROOT) as worker:
        try:
            until = time.monotonic() + 60
            while not (beside := [pid for pid in processes(folder) if pid != worker.pid]):
                assert time.monotonic() < until
                time.sleep(0.1)
            while len([*(folder / ".library" / "workers").glob("*-short.lock")]) != 1:
                assert time.monotonic() < until
                time.sleep(0.1)
        finally:
            worker.send_signal(how)
    assert len(beside) == 1
    until = time.monotonic() + 30
    while processes(folder):
        assert time.monotonic() < until
        time.sleep(0.1)


def test_gunicorn_has_no_control_socket_and_forks_before_it_loads():
    options = gunicorn_options(Settings(), fd=3, workers=2)
    assert options["control_socket_disable"] is True
    assert options["preload_app"] is False


HALF = {
    "nothing": b"",
    "a head": b"GET /healthz HTTP/1.1\r\nHost: here\r\n",
    "a body": b"POST /sign-in HTTP/1.1\r\nHost: here\r\nContent-Length: 9000\r\n\r\nname=",
    "a piece": b"POST /sign-in HTTP/1.1\r\nHost: here\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nna",
}


@pytest.fixture(scope="module")
def impatient(tmp_path_factory):
    """Port and address of a server that waits a second for a client that keeps a thread, four for others."""
    folder = new_library(tmp_path_factory.mktemp("impatient") / "library")
    with pytest.MonkeyPatch.context() as patch, reserved_port() as port:
        patch.setenv("EXPMAP_SERVE_PATIENCE_S", "1")
        with served(folder, port) as (_, url, _):
            yield port, url


def test_a_body_that_nobody_read_and_the_next_request_in_one_piece_stop_no_process(impatient):
    port, url = impatient
    with socket.create_connection(("127.0.0.1", port)) as client, client.makefile("rb") as answers_:
        client.settimeout(20)
        client.sendall(
            b"POST /api/v1/maps/park/undo HTTP/1.1\r\nHost: here\r\nContent-Type: application/json\r\n"
            b"Content-Length: 12\r\n\r\n"
        )
        assert answers_.readline() == b"HTTP/1.1 401 UNAUTHORIZED\r\n"
        client.sendall(b'{"seen": 12}GET /sign-in HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n')
        assert b"HTTP/1.1 200 OK\r\n" in answers_.read()
        assert answers(url)


@pytest.mark.parametrize("sent", HALF)
def test_clients_that_stop_half_way_keep_no_thread(impatient, sent):
    port, url = impatient
    with ExitStack() as stack:
        clients = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(24)]
        for client in clients:
            client.sendall(HALF[sent])
        start = time.monotonic()
        assert answers(url)
        assert time.monotonic() - start < 10, "3 rounds of 8 threads, a second each"
        for client in clients:
            client.settimeout(10)
            while client.recv(4096):
                pass


def test_a_client_whose_request_is_held_back_for_a_while_is_answered(impatient):
    port, _ = impatient
    with socket.create_connection(("127.0.0.1", port)) as client:
        time.sleep(2)
        client.sendall(b"GET /livez HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n")
        client.settimeout(10)
        assert client.makefile("rb").readline() == b"HTTP/1.1 200 OK\r\n"
