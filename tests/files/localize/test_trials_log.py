"""After a kill, trials are restored up to the last whole line, and only for the same map."""

import pytest

from webapp.files.localize.calibration import recorded_trials


class Killed(BaseException):
    """Stands for a killed process."""


def killed_after(path, key, *numbers):
    with pytest.raises(Killed), recorded_trials(path, key) as (_, keep):
        for number in numbers:
            keep(number, {"error_px": float(number)})
        raise Killed


def test_they_come_back_after_a_kill(tmp_path):
    path = tmp_path / "new" / "trials"
    killed_after(path, "a", 0, 1)
    killed_after(path, "a", 2)
    with recorded_trials(path, "a") as (known, keep):
        assert known == {n: {"error_px": float(n)} for n in range(3)}
        keep(3, None)
    with recorded_trials(path, "a") as (known, _):
        assert sorted(known) == [0, 1, 2, 3]


def test_half_a_line_does_not_count(tmp_path):
    path = tmp_path / "trials"
    killed_after(path, "a", 0, 1)
    path.write_bytes(path.read_bytes()[:-5])
    killed_after(path, "a", 5)
    with recorded_trials(path, "a") as (known, _):
        assert sorted(known) == [0, 5]


@pytest.mark.parametrize("content", ["", "{", "3", "[]"])
def test_another_file_does_not_count(tmp_path, content):
    path = tmp_path / "trials"
    path.write_text(content)
    with recorded_trials(path, "a") as (known, _):
        assert known == {}


def test_those_of_another_map_do_not_count(tmp_path):
    path = tmp_path / "trials"
    killed_after(path, "a", 0)
    with recorded_trials(path, "b") as (known, _):
        assert known == {}
