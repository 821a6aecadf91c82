"""Data on the robot's disk survives kills; damage is detected, and only damaged data is lost."""

import io
import json
import random
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from tests.robot.damage import PAGE, damage_page, damage_record, database, root_page
from webapp.errors import Conflict, DiskFull, InputError, UsageError
from webapp.robot.content import read_content
from webapp.robot.database import DatabaseDamaged
from webapp.robot.options import RobotOptions
from webapp.robot.schema import Identity
from webapp.robot.spool import Gap, RecordRun, Spool

WHO = Identity("", 7, "http://127.0.0.1:1", "")
ROOT = Path(__file__).resolve().parents[2]


def record(number):
    return json.dumps({"type": "pose", "n": number}).encode()


def filled(folder, count, *, options=None):
    spool = Spool(folder, identity=WHO, options=options)
    for number in range(count):
        assert spool.append(record(number), sync=False) == number
    return spool


def drain(spool):
    """Return what an uploader would send, and the gaps; everything is acknowledged or set aside."""
    texts, gaps = [], []
    while (found := spool.next_batch(records=3, size=1000)) is not None:
        if isinstance(found, Gap):
            gaps.append((found.first, found.count))
            spool.set_aside(found.count, reason="damaged")
        else:
            texts += found.texts
            spool.acknowledge(len(found.texts))
    return [json.loads(text)["n"] for text in texts], gaps


def test_records_come_back_in_order(tmp_path):
    spool = filled(tmp_path / "s", 500)
    assert drain(spool) == (list(range(500)), [])
    assert (spool.waiting, spool.next_batch(records=3, size=1000)) == (0, None)
    spool.close()


def test_what_is_taken_has_at_most_so_many_records_and_bytes(tmp_path):
    spool = filled(tmp_path / "s", 200)
    assert spool.next_batch(records=70, size=10**6) == RecordRun(0, tuple(map(record, range(70))))
    assert len(spool.next_batch(records=200, size=1000).texts) == 1000 // len(record(30))
    assert len(spool.next_batch(records=200, size=1).texts) == 1
    spool.close()


def test_a_new_start_continues_after_what_is_acknowledged(tmp_path):
    spool = filled(tmp_path / "s", 10)
    spool.acknowledge(4)
    spool.close()
    spool = Spool(tmp_path / "s", identity=WHO)
    assert (spool.next, spool.state.wire) == (10, 4)
    spool.append(record(10), sync=True)
    assert drain(spool) == (list(range(4, 11)), [])
    spool.close()


def test_many_threads_add_records(tmp_path):
    spool = Spool(tmp_path / "s", identity=WHO)

    def add(begin):
        for number in range(begin, begin + 100):
            spool.append(record(number), sync=False)
            spool.sync()

    threads = [threading.Thread(target=add, args=(begin,)) for begin in range(0, 400, 100)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    numbers, gaps = drain(spool)
    assert sorted(numbers) == list(range(400)) and gaps == []
    assert all(
        [n for n in numbers if n // 100 == part] == [*range(part * 100, part * 100 + 100)]
        for part in range(4)
    )
    spool.close()


def test_damaged_records_cost_themselves_and_are_listed(tmp_path):
    filled(tmp_path / "s", 40).close()
    for number in (3, 4, 5, 20, 39):
        damage_record(tmp_path / "s", number)
    spool = Spool(tmp_path / "s", identity=WHO)
    numbers, gaps = drain(spool)
    assert gaps == [(3, 3), (20, 1), (39, 1)]
    assert numbers == [n for n in range(40) if n not in (3, 4, 5, 20, 39)]
    assert [(e["first"], e["count"]) for e in read_content(tmp_path / "s").aside] == gaps
    assert (spool.state.wire, spool.next) == (35, 40)
    spool.close()


def test_missing_records_are_a_gap(tmp_path):
    filled(tmp_path / "s", 400).close()
    with closing(sqlite3.connect(database(tmp_path / "s"))) as connection:
        connection.execute("DELETE FROM records WHERE number BETWEEN 100 AND 250")
        connection.commit()
    spool = Spool(tmp_path / "s", identity=WHO)
    assert drain(spool)[1] == [(100, 151)]
    spool.close()


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_page_costs_its_records_at_most(tmp_path, seed):
    folder = tmp_path / "s"
    filled(folder, 300).close()
    pages = database(folder).stat().st_size // PAGE
    others = {
        1,
        *(
            root_page(folder, name)
            for name in ("spool", "records", "aside", "photos", "aside_by_stop", "sqlite_sequence")
        ),
    }
    damage_page(folder, random.Random(seed).choice([n for n in range(1, pages + 1) if n not in others]))
    spool = Spool(folder, identity=WHO)
    next_ = spool.next
    numbers, gaps = drain(spool)
    lost = [n for first, count in gaps for n in range(first, first + count)]
    assert sorted(numbers + lost) == list(range(next_)) and 0 < 300 - len(numbers) < 40
    spool.close()


def test_numbers_that_left_the_robot_are_not_given_again(tmp_path):
    spool = filled(tmp_path / "s", 5)
    spool.next_batch(records=5, size=1000)
    spool.close()
    with closing(sqlite3.connect(database(tmp_path / "s"))) as connection:
        connection.execute("DELETE FROM records WHERE number = 4")
        connection.commit()
    spool = Spool(tmp_path / "s", identity=WHO)
    assert spool.append(b'{"n": 5}', sync=True) == 5
    assert drain(spool) == ([0, 1, 2, 3, 5], [(4, 1)])
    spool.close()


@pytest.mark.parametrize("page", ["first", "records", "spool"])
def test_a_damaged_database_is_set_aside_and_what_can_be_read_is_kept(tmp_path, page):
    folder = tmp_path / "s"
    spool = filled(folder, 300)
    spool.acknowledge(100)
    spool.add_photo(io.BytesIO(b"photo"), name="a.jpg", time=1.0, object_id=None)
    spool.close()
    before = read_content(folder).identity.id
    damage_page(folder, 1 if page == "first" else root_page(folder, page))
    damaged = database(folder).read_bytes()
    if page != "records":
        with pytest.raises(DatabaseDamaged, match="damaged"):
            read_content(folder)
    spool = Spool(folder, identity=WHO)
    assert database(folder).parent.with_name("damaged-1").joinpath("spool.sqlite3").read_bytes() == damaged
    (note,) = read_content(folder).aside
    assert note["reason"].startswith("the database was damaged") and "damaged-1" in note["reason"]
    assert len(list((folder / "damaged-1" / "photos").iterdir())) == 1
    if page == "records":  # its state is readable: the same sender, with a gap for the records
        assert (spool.identity.id, spool.state.next, spool.photos.count) == (before, 100, 1)
    else:
        assert spool.identity.id != before and (spool.next, spool.photos.count) == (0, 0)
    spool.append(b'{"n": 1000}', sync=True)
    assert drain(spool)[0][-1] == 1000
    spool.close()
    Spool(folder, identity=WHO).close()
    assert not (folder / "damaged-2").exists()


def test_a_salvage_that_was_killed_begins_again(tmp_path):
    folder = tmp_path / "s"
    filled(folder, 30).close()
    (folder / "data").rename(folder / "damaged-1")
    (folder / "data.tmp" / "photos").mkdir(parents=True)
    (folder / "data.tmp" / "spool.sqlite3").write_bytes(b"half")
    spool = Spool(folder, identity=WHO)
    assert drain(spool) == (list(range(30)), [])
    spool.close()


def test_damage_that_is_found_later_has_the_database_set_aside_at_the_next_start(tmp_path):
    folder = tmp_path / "s"
    filled(folder, 300).close()
    damage_page(folder, root_page(folder, "aside_by_stop"))
    spool = Spool(folder, identity=WHO)
    with pytest.raises(DatabaseDamaged, match="damaged"):
        spool.next_batch(records=10, size=1000)
    spool.append(record(300), sync=True)
    spool.close()
    spool = Spool(folder, identity=WHO)
    assert (folder / "damaged-1").exists() and drain(spool) == (list(range(301)), [])
    spool.close()


def test_a_full_spool_forgets_what_the_server_has_and_then_refuses(tmp_path):
    spool = Spool(tmp_path / "s", identity=WHO, options=RobotOptions(limit_mb=0.05))
    for number in range(5000):  # far more than fits
        spool.append(record(number), sync=False)
        spool.acknowledge(1)
    with pytest.raises(DiskFull, match="full"):
        for number in range(5000):
            spool.append(record(5000 + number), sync=False)
    written = spool.next
    assert (
        spool.size <= 50_000 + PAGE and database(tmp_path / "s").stat().st_size <= 60_000 and written > 5500
    )
    assert drain(spool) == (list(range(5000, written)), [])
    spool.append(record(written), sync=False)  # there is space again
    spool.close()


def test_a_database_that_cannot_grow_is_given_what_the_server_has(tmp_path):
    spool = filled(tmp_path / "s", 3000)
    spool.acknowledge(2900)
    pages = spool._database.select("PRAGMA page_count")[0][0]
    spool._database.select(f"PRAGMA max_page_count = {pages}")
    for number in range(3000, 5000):
        spool.append(record(number), sync=False)
    with pytest.raises(DiskFull):
        for number in range(5000, 9000):
            spool.append(record(number), sync=False)
    written = spool.next
    assert drain(spool) == (list(range(2900, written)), [])
    spool.append(record(written), sync=False)
    spool.close()


def test_a_spool_has_one_owner(tmp_path):
    spool = filled(tmp_path / "s", 1)
    with pytest.raises(Conflict, match="another program"):
        Spool(tmp_path / "s", identity=WHO)
    spool.close()
    Spool(tmp_path / "s", identity=WHO).close()


def test_another_process_is_refused_but_may_look(tmp_path):
    spool = filled(tmp_path / "s", 3)
    program = (
        "import sys; from pathlib import Path; from tests.robot.test_spool import *\n"
        "print(read_content(Path(sys.argv[1])).written)\n"
        "try: Spool(Path(sys.argv[1]), identity=WHO)\n"
        "except Conflict as error: print(error)"
    )
    words = [sys.executable, "-c", program, tmp_path / "s"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("3\n") and "another program is using this spool" in done.stdout
    spool.append(record(3), sync=False)
    assert read_content(tmp_path / "s").waiting == 4
    spool.close()


def test_a_killed_owner_leaves_it_to_the_next(tmp_path):
    program = (
        "import os, sys; from pathlib import Path; from tests.robot.test_spool import *\n"
        "filled(Path(sys.argv[1]), 100); os.kill(os.getpid(), 9)\n"
    )
    killed = subprocess.run([sys.executable, "-c", program, tmp_path / "s"], cwd=ROOT)
    assert killed.returncode == -9
    assert read_content(tmp_path / "s").waiting == 100
    spool = Spool(tmp_path / "s", identity=WHO)
    assert drain(spool) == (list(range(100)), [])
    spool.close()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9, 0.99])
def test_a_power_cut_costs_the_end_of_the_log_only(tmp_path, share):
    spool = filled(tmp_path / "s", 50)
    spool.sync()
    log = tmp_path / "s" / "data" / "spool.sqlite3-wal"
    synced = log.stat().st_size
    for number in range(50, 100):
        spool.append(record(number), sync=False)
    after = tmp_path / "after"  # the disk after the power cut
    shutil.copytree(tmp_path / "s", after)
    with (after / "data" / "spool.sqlite3-wal").open("r+b") as file:
        file.truncate(int(synced + share * (log.stat().st_size - synced)))
    spool.close()
    spool = Spool(after, identity=WHO)
    numbers, gaps = drain(spool)
    assert numbers == list(range(len(numbers))) and 50 <= len(numbers) < 100 and gaps == []
    spool.close()


def test_a_spool_belongs_to_one_mission_and_one_thing(tmp_path):
    filled(tmp_path / "s", 1).close()
    with pytest.raises(UsageError, match="mission 7, not 8"):
        Spool(tmp_path / "s", identity=Identity("", 8, WHO.url, ""))
    with pytest.raises(UsageError, match="something else"):
        Spool(tmp_path / "s", identity=Identity("", 7, WHO.url, "another bag"))
    moved = Spool(tmp_path / "s", identity=Identity("", 7, "http://elsewhere", ""))
    assert moved.identity.url == "http://elsewhere"
    moved.close()
    assert read_content(tmp_path / "s").identity.url == "http://elsewhere"
    with pytest.raises(UsageError, match="no spool"):
        read_content(tmp_path / "empty")
    assert not (tmp_path / "empty").exists()


def test_a_spool_of_version_0_7_is_refused_with_the_way_out(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "spool.json").write_text(
        '{"format": 1, "id": "a", "mission": 7, "url": "http://x", "about": ""}'
    )
    (folder / "records-000000000000.log").write_bytes(b"00000000 0 {}\n")
    for use in (lambda: Spool(folder, identity=WHO), lambda: read_content(folder)):
        with pytest.raises(UsageError, match=r"version 0\.7") as refusal:
            use()
        assert "expmap robot recover" in refusal.value.hint
    assert sorted(path.name for path in folder.iterdir()) == ["records-000000000000.log", "spool.json"]


def test_a_spool_of_a_newer_program_is_refused(tmp_path):
    filled(tmp_path / "s", 1).close()
    with closing(sqlite3.connect(database(tmp_path / "s"))) as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(UsageError, match="newer"):
        Spool(tmp_path / "s", identity=WHO)


def test_going_back_finds_the_record_among_those_set_aside(tmp_path):
    spool = filled(tmp_path / "s", 10)
    spool.acknowledge(2)
    spool.set_aside(2, reason="no")
    spool.acknowledge(3)
    assert (spool.state.next, spool.state.wire) == (7, 5)
    assert spool.rewind(1)
    assert drain(spool) == ([1, 4, 5, 6, 7, 8, 9], [])
    assert spool.state.wire == 8
    assert spool.rewind(2) and spool.state.next == 4
    assert spool.rewind(0) and drain(spool)[0] == [0, 1, 4, 5, 6, 7, 8, 9]
    spool.close()


def test_a_record_that_is_too_long_is_refused(tmp_path):
    spool = filled(tmp_path / "s", 1)
    with pytest.raises(InputError, match="bytes"):
        spool.append(b"x" * 100_001, sync=False)
    spool.append(b'"' + b"x" * 99_998 + b'"', sync=True)
    spool.close()
