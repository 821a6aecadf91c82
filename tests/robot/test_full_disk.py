"""A disk is filled completely and freed again: everything arrives, once, without a restart."""

import contextlib
import hashlib
import io
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests.ports import reserved_port
from tests.robot.stand_in import refused
from tests.robot.test_kills import run, stored
from webapp.errors import DiskFull
from webapp.robot import RobotClient
from webapp.robot.content import has_spool, read_content
from webapp.robot.database import RESERVE_BYTES

MEGABYTE = 1_000_000


class SmallDisk:
    """A small file system with a file that fills it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._filler = folder / "somebody-else"

    def fill(self, *, but: int = 0) -> None:
        """Leave a number of bytes free."""
        with self._filler.open("ab", buffering=0) as file:
            for block in (1 << 20, 1 << 12, 1):
                with contextlib.suppress(OSError):
                    while file.write(bytes(block)) == block:
                        pass
        if but:
            os.truncate(self._filler, max(self._filler.stat().st_size - but, 0))

    def free(self) -> None:
        """Delete the other file."""
        self._filler.unlink(missing_ok=True)

    def free_bytes(self) -> int:
        found = os.statvfs(self.folder)
        return found.f_bavail * found.f_frsize


@pytest.fixture
def disk(tmp_path):
    """A disk of 16 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=16m", "none", str(folder)]
    try:
        subprocess.run(mount, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"NOT TESTED, a full disk: no file system can be mounted here ({error})")
    yield SmallDisk(folder)
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


class Walk:
    """Adds poses numbered by their times, and keeps those that the client accepted."""

    def __init__(self, client):
        self.client = client
        self.taken = []
        self._next = 0

    def go(self, count):
        """Add poses until the disk is full, and return how many were accepted."""
        before = len(self.taken)
        for _ in range(count):
            try:
                self.client.pose(50, 14, time_s=self._next)
            except DiskFull:
                break
            self.taken.append(self._next)
            self._next += 1
        return len(self.taken) - before


@pytest.fixture
def start(disk, server, quick):
    with contextlib.ExitStack() as stack:
        yield lambda **more: stack.enter_context(
            RobotClient(server.url, "token", mission=7, spool=disk.folder / "spool", options=quick(**more))
        )


def times(server):
    return [record["time"] for record in server.stored()] if server.records else []


def test_a_disk_filled_to_the_last_byte_and_freed(start, server, disk, until):
    server.script = lambda path, body: refused(503)
    client = start()
    walk = Walk(client)
    assert walk.go(2000) == 2000
    disk.fill()
    assert disk.free_bytes() == 0
    walk.go(2000)
    with pytest.raises(DiskFull, match="full"):
        for _ in range(2000):
            client.pose(50, 14, time_s=walk.taken[-1])
            walk.taken.append(walk.taken[-1])
    server.script = lambda path, body: None
    until(lambda: client.status().waiting == 0)  # acknowledged while the disk is full
    assert times(server) == walk.taken
    disk.fill()  # others use the remaining space of the reserve
    for _ in range(20):  # sent records free space for new ones
        assert walk.go(500) > 0
        disk.fill()
        until(lambda: client.status().waiting == 0)
    assert disk.free_bytes() == 0 and times(server) == walk.taken
    disk.free()
    reserve = disk.folder / "spool" / "reserve"
    until(lambda: walk.go(1) and reserve.exists())
    assert walk.go(3000) == 3000
    until(lambda: client.status().waiting == 0)
    assert times(server) == walk.taken
    assert reserve.stat().st_size == RESERVE_BYTES


@pytest.mark.parametrize("seed", range(2))
def test_in_any_order_everything_arrives_once(start, server, disk, until, seed):
    rng = random.Random(seed)
    online = [True]
    server.script = lambda path, body: None if online[0] else refused(503)
    client = start(batch_records=50)
    walk = Walk(client)
    for _ in range(100):
        match rng.choice(["go", "go", "go", "fill", "nearly", "free", "online", "offline", "wait"]):
            case "go":
                walk.go(rng.randrange(500))
            case "fill":
                disk.fill()
            case "nearly":
                disk.fill(but=rng.randrange(100_000))
            case "free":
                disk.free()
            case "online":
                online[0] = True
            case "offline":
                online[0] = False
            case "wait":
                client.upload(wait_s=0.1)
    online[0] = True
    assert client.upload(wait_s=60)
    assert times(server) == walk.taken
    disk.free()
    assert walk.go(100) == 100, "at once"
    assert client.upload(wait_s=60) and times(server) == walk.taken


@pytest.fixture
def port():
    with reserved_port() as port:
        yield port


@pytest.mark.parametrize("ends", ["killed", "by its error"])
def test_a_client_that_ended_on_a_full_disk_continues_there(disk, port, tmp_path, until, ends):
    spool, file = disk.folder / "spool", tmp_path / "stored"
    words = ("walker", f"http://127.0.0.1:{port}", spool, 600)
    walker = run(*words)
    until(lambda: has_spool(spool) and read_content(spool).written > 50)
    disk.fill()
    if ends == "killed":
        walker.kill()
    walker.wait(60)
    disk.fill()
    server = run("stand_in", port, file)
    program = (
        "import sys; from pathlib import Path; from webapp.robot import RobotClient\n"
        "client = RobotClient(sys.argv[1], 'token', mission=7, spool=Path(sys.argv[2]))\n"
        "print(client.status().written, client.upload(wait_s=60)); client.close()"
    )
    try:
        started = [sys.executable, "-c", program, words[1], words[2]]
        done = subprocess.run(list(map(str, started)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        written, arrived = done.stdout.split()
        assert arrived == "True" and stored(file) == list(range(int(written))) and int(written) > 50
        disk.free()
        walker = run(*words)
        assert walker.wait(300) == 0
    finally:
        for process in (walker, server):
            process.kill()
            process.wait()
    assert stored(file) == list(range(600))


def test_a_photo_that_does_not_fit_leaves_nothing(start, server, disk, until):
    def script(path, body):
        if not path.endswith("/photos"):
            return None
        return 201, {"sha256": hashlib.sha256(photo).hexdigest()}, {}

    photo = b"\xff" * MEGABYTE
    server.script = script
    client = start(every_s=None)
    client.photo(io.BytesIO(photo), name="first.jpg")
    disk.fill(but=MEGABYTE // 2)
    with pytest.raises(DiskFull):
        client.photo(io.BytesIO(photo), name="second.jpg")
    assert len(list((disk.folder / "spool" / "data" / "photos").iterdir())) == 1
    disk.fill()
    client.upload()
    until(lambda: client.status().photos == 0)
    disk.free()
    until(lambda: adds(client, photo))
    assert client.upload(wait_s=60)


def adds(client, photo):
    try:
        return client.photo(io.BytesIO(photo), name="second.jpg")
    except DiskFull:
        return ""
