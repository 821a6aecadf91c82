"""Progress in the terminal: a bar with the remaining time, on standard error."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from tqdm import tqdm

from webapp.cli.exitcodes import INTERRUPTED
from webapp.progress import Progress


class TerminalProgress(Progress):
    """Shows a bar if standard error is a terminal, else one line per stage.

    Args:
        what: Shown before the bar.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._bar: tqdm[Any] | None = None
        self.stopped = False

    def size(self, total: int) -> None:
        """Start a bar of `total` steps."""
        self.close()
        if total and sys.stderr.isatty():
            self._bar = tqdm(total=total, desc=self._what, unit="", file=sys.stderr, dynamic_ncols=True)

    def advance(self, steps: int = 1) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.update(steps)

    def note(self, text: str) -> None:
        """Show the name of the stage."""
        self._what = text
        if self._bar is not None:
            self._bar.set_description(text)
        else:
            print(f"{text} ...", file=sys.stderr, flush=True)  # noqa: T201

    def cancelled(self) -> bool:
        """Return whether Ctrl-C was pressed."""
        return self.stopped

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


@contextmanager
def terminal_progress(what: str) -> Iterator[TerminalProgress]:
    """Show progress; the first Ctrl-C stops without losing results, the second one exits at once."""
    progress = TerminalProgress(what)

    def stop(_signal: int, _frame: FrameType | None) -> None:
        if progress.stopped:
            # Finished parts are saved; an exception here could leave processes in a deadlock.
            print("interrupted", file=sys.stderr, flush=True)  # noqa: T201
            os._exit(INTERRUPTED)
        progress.stopped = True
        print("\nstopping; press Ctrl-C again to stop at once", file=sys.stderr)  # noqa: T201

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield progress
    finally:
        signal.signal(signal.SIGINT, before)
        progress.close()
