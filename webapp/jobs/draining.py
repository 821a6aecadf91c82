"""How the processes of a server learn that it is going to stop, before they are asked to: by a pipe.

The supervisor holds its writing end. Once that is closed, also because the supervisor was killed, all that
have inherited the reading end see it, however often they were started again in between.
"""

from __future__ import annotations

import os
import select
from types import TracebackType
from typing import Self

from webapp.configuration import DRAINING_FD, draining_fd


class Drain:
    """The supervisor's side; a context that closes the pipe."""

    def __init__(self) -> None:
        self.reading_end, self._writing_end = os.pipe()
        self._begun = False

    @property
    def environment(self) -> dict[str, str]:
        """For processes that inherit the reading end."""
        return {DRAINING_FD: str(self.reading_end)}

    def begin(self) -> None:
        """Let all know."""
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
    """Return whether the server of this process is going to stop; False where it has no supervisor."""
    number = draining_fd()
    if number is None:
        return False
    look = select.poll()
    look.register(number, select.POLLIN)
    return any(happened & select.POLLHUP for _, happened in look.poll(0))
