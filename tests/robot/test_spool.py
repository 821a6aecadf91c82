"""What is on the robot's disk survives kills and power cuts, and damage is told."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.errors import Conflict, DiskFull, InputError, UsageError
from webapp.robot.frames import decode, encode
from webapp.robot.identity import Identity
from webapp.robot.options import RobotOptions
from webapp.robot.segments import Gap, Run
from webapp.robot.spool import Spool, read_aside, read_state

WHO = Identity("", 7, "http://127.0.0.1:1", "")
SMALL = RobotOptions(segment_kb=0.2)


def record(number):
    return json.dumps({"type": "pose", "n": number}).encode()


def filled(folder, count, *, options=None):
    spool = Spool(folder, identity=WHO, options=options)
    for number in range(count):
        assert spool.append(record(number), sync=False) == number
    return spool


def drain(spool):
    """What an uploader would send, and the gaps; all of it is acknowledged or set aside."""
    texts, gaps = [], []
    while (found := spool.read(records=3, size=1000)) is not None:
        if isinstance(found, Gap):
            gaps.append((found.first, found.count))
            spool.set_aside(found.count, reason="damaged")
        else:
            texts += found.texts
            spool.mark_sent(found.first + len(found.texts))
            spool.acknowledge(len(found.texts))
    return [json.loads(text)["n"] for text in texts], gaps


@given(st.integers(0, 10**12), st.binary().filter(lambda text: b"\n" not in text))
def test_lines_are_read_as_they_were_written(number, text):
    assert decode(encode(number, text)) == (number, text)


@given(st.data())
@settings(max_examples=300)
def test_no_flipped_bit_goes_unnoticed(data):
    line = bytearray(encode(data.draw(st.integers(0, 10**6)), data.draw(st.binary(max_size=60))))
    bit = data.draw(st.integers(0, len(line) * 8 - 1))
    line[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(line)) is None


def test_records_come_back_in_order_over_many_files(tmp_path):
    spool = filled(tmp_path / "s", 50, options=SMALL)
    assert len(list((tmp_path / "s").glob("records-*.log"))) > 3
    assert drain(spool) == (list(range(50)), [])
    assert (spool.waiting, spool.read(records=3, size=1000)) == (0, None)
    spool.close()


def test_a_new_start_goes_on_behind_what_is_acknowledged(tmp_path):
    spool = filled(tmp_path / "s", 10, options=SMALL)
    spool.acknowledge(4)
    spool.close()
    spool = Spool(tmp_path / "s", identity=WHO, options=SMALL)
    assert (spool.next, spool.state.wire) == (10, 4)
    spool.append(record(10), sync=True)
    assert drain(spool) == (list(range(4, 11)), [])
    spool.close()


def test_a_record_torn_at_any_byte_is_cut_off_and_told(tmp_path):
    filled(tmp_path / "s", 3).close()
    (file,) = (tmp_path / "s").glob("records-*.log")
    whole = file.read_bytes()
    last = whole.index(b"\n", whole.index(b"\n") + 1) + 1
    for end in range(last, len(whole)):
        file.write_bytes(whole[:end])
        spool = Spool(tmp_path / "s", identity=WHO)
        assert (spool.next, spool.torn) == (2, end - last)
        assert spool.append(record(2), sync=True) == 2
        spool.state = read_state(tmp_path / "s")
        found = spool.read(records=9, size=1000)
        assert found == Run(0, (record(0), record(1), record(2)))
        spool.close()
        assert file.read_bytes() == whole
    told = [entry["reason"] for entry in read_aside(tmp_path / "s")]
    assert len(told) == len(whole) - last - 1 and "unfinished" in told[0]


@pytest.mark.parametrize("rubbish", [b"\0" * 5000, b"\n\n\n", os.urandom(3000)])
def test_blocks_that_never_reached_the_disk_are_cut_off(tmp_path, rubbish):
    filled(tmp_path / "s", 3).close()
    (file,) = (tmp_path / "s").glob("records-*.log")
    with file.open("ab") as end:
        end.write(rubbish)
    spool = Spool(tmp_path / "s", identity=WHO)
    assert spool.torn == len(rubbish)
    spool.append(record(3), sync=True)
    assert drain(spool) == ([0, 1, 2, 3], [])
    spool.close()


def test_a_flipped_bit_in_the_middle_costs_what_it_damaged_and_is_told(tmp_path):
    filled(tmp_path / "s", 40, options=SMALL).close()
    files = sorted((tmp_path / "s").glob("records-*.log"))
    for place, file in enumerate(files[:-1]):  # the last line of the last file would be a torn one
        data = bytearray(file.read_bytes())
        data[place * 7 % len(data)] ^= 0x10
        file.write_bytes(data)
    spool = Spool(tmp_path / "s", identity=WHO, options=SMALL)
    numbers, gaps = drain(spool)
    lost = [n for first, count in gaps for n in range(first, first + count)]
    assert sorted(numbers + lost) == list(range(40)) and numbers == sorted(numbers)
    assert len(files) - 1 <= len(lost) <= 2 * len(files)  # a flipped line end damages two
    assert [(e["first"], e["count"]) for e in read_aside(tmp_path / "s")] == gaps
    assert spool.state.wire == len(numbers)
    spool.close()


def test_a_missing_file_is_a_gap(tmp_path):
    filled(tmp_path / "s", 40, options=SMALL).close()
    files = sorted((tmp_path / "s").glob("records-*.log"))
    files[1].unlink()
    first, end = (int(file.stem.partition("-")[2]) for file in (files[1], files[2]))
    spool = Spool(tmp_path / "s", identity=WHO, options=SMALL)
    assert drain(spool)[1] == [(first, end - first)]
    spool.close()


def test_numbers_that_left_the_robot_are_not_given_again(tmp_path):
    spool = filled(tmp_path / "s", 5)
    spool.mark_sent(5)
    spool.close()
    (file,) = (tmp_path / "s").glob("records-*.log")
    data = bytearray(file.read_bytes())
    data[-3] ^= 1  # the last record is damaged, and looks torn
    file.write_bytes(data)
    spool = Spool(tmp_path / "s", identity=WHO)
    assert spool.append(b'{"n": 5}', sync=True) == 5
    assert drain(spool) == ([0, 1, 2, 3, 5], [(4, 1)])
    spool.close()


def test_what_was_set_aside_stays_so_even_if_the_state_was_not_written(tmp_path):
    spool = filled(tmp_path / "s", 5)
    spool.acknowledge(2)
    before = (tmp_path / "s" / "state.log").read_bytes()
    spool.set_aside(1, reason="no", text=record(2))
    spool.close()
    (tmp_path / "s" / "state.log").write_bytes(before)
    spool = Spool(tmp_path / "s", identity=WHO)
    assert drain(spool) == ([3, 4], [])
    assert spool.state.wire == 4
    spool.close()


@pytest.mark.parametrize("cut", range(1, 30))
def test_a_torn_state_is_the_one_before(tmp_path, cut):
    spool = filled(tmp_path / "s", 5)
    spool.acknowledge(2)
    spool.acknowledge(1)
    spool.close()
    state = tmp_path / "s" / "state.log"
    state.write_bytes(state.read_bytes()[:-cut])
    spool = Spool(tmp_path / "s", identity=WHO)
    assert spool.state.next == 2
    spool.acknowledge(3)
    spool.close()
    assert read_state(tmp_path / "s").next == 5


def test_the_state_does_not_grow_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr("webapp.robot.spool._STATE_BYTES", 500)
    spool = filled(tmp_path / "s", 100)
    for _ in range(100):
        spool.acknowledge(1)
    spool.close()
    assert (tmp_path / "s" / "state.log").stat().st_size < 1000
    assert read_state(tmp_path / "s").next == 100


def test_a_full_spool_forgets_what_the_server_has_and_then_refuses(tmp_path):
    options = RobotOptions(segment_kb=0.5, limit_mb=0.003)
    spool = Spool(tmp_path / "s", identity=WHO, options=options)
    for number in range(300):  # far more than fits
        spool.append(record(number), sync=False)
        spool.acknowledge(1)
    with pytest.raises(DiskFull, match="full"):
        for number in range(300):
            spool.append(record(300 + number), sync=False)
    written = spool.next
    assert spool.size <= 3000
    assert drain(spool) == (list(range(300, written)), [])
    spool.append(record(written), sync=False)  # there is room again
    spool.close()


def test_a_full_disk_keeps_what_is_whole(tmp_path, monkeypatch):
    spool = filled(tmp_path / "s", 3)
    write, room = os.write, [10]

    def scarce(descriptor, data):
        if not room[0]:
            raise OSError(errno.ENOSPC, "no space left")
        taken = write(descriptor, bytes(data)[: room[0]])
        room[0] -= taken
        return taken

    monkeypatch.setattr(os, "write", scarce)
    with pytest.raises(DiskFull):
        spool.append(record(3), sync=False)
    monkeypatch.undo()
    assert spool.append(record(3), sync=False) == 3
    assert drain(spool) == ([0, 1, 2, 3], [])
    spool.close()


def test_a_full_disk_is_given_what_the_server_has(tmp_path, monkeypatch):
    spool = filled(tmp_path / "s", 40, options=SMALL)
    spool.acknowledge(30)
    write, failures = os.write, [OSError(errno.ENOSPC, "no space left")] * 2

    def scarce(descriptor, data):
        if failures:
            raise failures.pop()
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", scarce)
    before = len(list((tmp_path / "s").glob("records-*.log")))
    assert spool.append(record(40), sync=True) == 40
    monkeypatch.undo()
    assert len(list((tmp_path / "s").glob("records-*.log"))) <= before - 1
    assert drain(spool) == (list(range(30, 41)), [])
    spool.close()


def test_a_spool_has_one_owner(tmp_path):
    spool = filled(tmp_path / "s", 1)
    with pytest.raises(Conflict, match="another program"):
        Spool(tmp_path / "s", identity=WHO)
    spool.close()
    Spool(tmp_path / "s", identity=WHO).close()


def test_a_killed_owner_leaves_it_to_the_next(tmp_path):
    program = (
        "import os, sys; from pathlib import Path\n"
        "from webapp.robot.spool import Spool; from webapp.robot.identity import Identity\n"
        "s = Spool(Path(sys.argv[1]), identity=Identity('', 7, 'http://127.0.0.1:1', ''))\n"
        "for n in range(100): s.append(b'{\"n\": %d}' % n, sync=False)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    root = Path(__file__).resolve().parents[2]
    killed = subprocess.run([sys.executable, "-c", program, tmp_path / "s"], cwd=root)
    assert killed.returncode != 0
    spool = Spool(tmp_path / "s", identity=WHO)
    assert (spool.torn, drain(spool)) == (0, (list(range(100)), []))
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
    with pytest.raises(UsageError, match="no spool"):
        Spool(tmp_path / "empty")
    assert not (tmp_path / "empty").exists()
    (tmp_path / "s" / "spool.json").write_text("{")
    with pytest.raises(InputError, match="damaged"):
        Spool(tmp_path / "s")


def test_going_back_finds_the_record_among_those_set_aside(tmp_path):
    spool = filled(tmp_path / "s", 10)
    spool.acknowledge(2)
    spool.set_aside(2, reason="no")
    spool.acknowledge(3)
    assert (spool.state.next, spool.state.wire) == (7, 5)
    assert spool.rewind(1)
    assert drain(spool) == ([1, 4, 5, 6, 7, 8, 9], [])
    assert spool.state.wire == 8
    spool.close()


def test_a_record_that_is_too_long_is_refused(tmp_path):
    spool = filled(tmp_path / "s", 1)
    with pytest.raises(InputError, match="bytes"):
        spool.append(b"x" * 100_001, sync=False)
    spool.close()
