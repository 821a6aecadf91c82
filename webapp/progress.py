"""Progress and cancellation of long operations."""

from __future__ import annotations

from webapp.errors import Cancelled


class Progress:
    """Progress that shows nothing; front ends derive from it.

    An operation calls `size` once it knows the number of steps, `advance` after each finished step, `skip`
    for those that an earlier run has finished, `note` to describe the current step, and `check` where it can
    stop without losing anything.
    """

    def size(self, total: int) -> None:
        """Report that the operation has `total` steps."""

    def advance(self, steps: int = 1) -> None:
        """Report that `steps` more steps are finished and saved."""

    def skip(self, steps: int = 1) -> None:
        """Report that `steps` steps were finished by an earlier run: they say nothing about the pace."""
        self.advance(steps)

    def note(self, text: str) -> None:
        """Describe the current step in a few words."""

    def cancelled(self) -> bool:
        """Return whether the user has requested a stop."""
        return False

    def check(self) -> None:
        """Raise `Cancelled` if the user has requested a stop."""
        if self.cancelled():
            raise Cancelled("stopped; what was finished is kept")
