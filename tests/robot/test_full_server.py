"""The disk of the server is filled and freed again: batches arrive, once, without a restart."""

import threading

import pytest
from werkzeug.serving import make_server

from tests.robot.site import Site
from tests.robot.test_full_disk import disk  # noqa: F401 - a fixture
from webapp.robot import RobotClient

BEFORE, MEANWHILE, AFTER = 200, 500, 50


@pytest.fixture
def site(disk):  # noqa: F811
    """The application with its library on the small disk."""
    site = Site(disk.folder / "library")
    http = make_server("127.0.0.1", 0, site.app, threaded=True)
    thread = threading.Thread(target=http.serve_forever, args=(0.05,))
    thread.start()
    site.url = f"http://127.0.0.1:{http.port}"
    yield site
    http.shutdown()
    thread.join()
    http.server_close()
    site.library.database.close()


def empties_its_log(library):
    """Checkpoint SQLite's log, whose space would otherwise be reused; return whether it worked."""
    with library.database.engine.connect() as connection:
        busy, *_ = connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)").one()
    return not busy


def test_batches_wait_while_the_disk_of_the_server_is_full(site, disk, tmp_path, quick, until):  # noqa: F811
    mission = site.new_mission()
    with RobotClient(
        site.url, site.token, mission=mission, spool=tmp_path / "spool", options=quick()
    ) as robot:

        def walk(first, count):
            for number in range(first, first + count):
                robot.pose(50, 14, time_s=number)

        walk(0, BEFORE)
        assert robot.upload(wait_s=60)
        until(lambda: empties_its_log(site.library))
        disk.fill()
        walk(BEFORE, MEANWHILE)
        assert not robot.upload(wait_s=3)
        status = robot.status()
        assert "full" in status.problem
        assert status.refused is None
        assert status.written - status.waiting == BEFORE
        assert site.poses().times_s.tolist() == list(range(BEFORE)), "what was acknowledged can be read"
        disk.free()
        walk(BEFORE + MEANWHILE, AFTER)
        robot.end()
        assert robot.upload(wait_s=60)
    assert site.poses().times_s.tolist() == list(range(BEFORE + MEANWHILE + AFTER))
    assert site.state()[2]
