"""A pipe that signals to the processes of a server that it is about to stop, before they get SIGTERM.

The supervisor holds the write end. When it is closed, also by the supervisor's death, all processes that
inherited the read end notice it, even those that were restarted.
"""

from __future__ import annotations

import os
import select
from types import TracebackType
from typing import Self

from webapp.configuration import DRAINING_FD, draining_fd


class Drain:
    """The supervisor's side; a context manager that closes the pipe."""

    def __init__(self) -> None:
        self.reading_end, self._writing_end = os.pipe()
        self._begun = False

    @property
    def environment(self) -> dict[str, str]:
        """Environment for processes that inherit the read end."""
        return {DRAINING_FD: str(self.reading_end)}

    def has_begun(self) -> bool:
        """Return whether the server is about to stop."""
        return self._begun

    def begin(self) -> None:
        """Signal the drain to all processes."""
        if not self._begun:
            self._begun = True
            os.close(self._writing_end)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.begin()
        os.close(self.reading_end)


def is_draining() -> bool:
    """Return whether the server of this process is about to stop; False if it has no supervisor."""
    number = draining_fd()
    if number is None:
        return False
    look = select.poll()
    look.register(number, select.POLLIN)
    return any(happened & select.POLLHUP for _, happened in look.poll(0))
