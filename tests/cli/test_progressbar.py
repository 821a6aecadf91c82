"""Progress in the terminal, and Ctrl-C."""

import io
import os
import signal
import sys

import pytest

from webapp.cli.progressbar import terminal_progress
from webapp.errors import Cancelled


class Terminal(io.StringIO):
    """Standard error as a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_bar_with_the_time_left_on_a_terminal(monkeypatch, capsys):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with terminal_progress("photos") as progress:
        progress.size(4)
        progress.advance(2)
        progress.note("joining")
        progress.advance(2)
    shown = terminal.getvalue()
    assert "photos" in shown
    assert "joining" in shown
    assert "4/4" in shown
    assert "<" in shown  # time passed < time left
    assert capsys.readouterr().out == ""


def test_a_line_a_stage_elsewhere(capsys):
    with terminal_progress("photos") as progress:
        progress.size(4)
        progress.advance(4)
        progress.note("joining")
    assert capsys.readouterr() == ("", "joining ...\n")


def test_nothing_to_do_shows_no_bar(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with terminal_progress("photos") as progress:
        progress.size(0)
    assert terminal.getvalue() == ""


def test_ctrl_c_asks_the_work_to_stop_and_is_as_before_afterwards(capsys):
    before = signal.getsignal(signal.SIGINT)
    with terminal_progress("photos") as progress:
        progress.check()
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(Cancelled):
            progress.check()
    assert signal.getsignal(signal.SIGINT) is before
    assert "press Ctrl-C again" in capsys.readouterr().err


def test_threads_do_not_wait_in_a_busy_loop_unless_asked_to(expmap, monkeypatch):
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    expmap("--version")
    assert os.environ["OMP_WAIT_POLICY"] == "passive"
    monkeypatch.setenv("OMP_WAIT_POLICY", "active")
    expmap("--version")
    assert os.environ["OMP_WAIT_POLICY"] == "active"
