"""How long work reports its progress, and how it is stopped."""

from __future__ import annotations

from webapp.errors import Cancelled


class Progress:
    """A silent progress; a front end derives from it and shows what is reported.

    Work calls `size` once it knows how many steps there are, `advance` after each finished step, `note`
    for a word on what is being done, and `check` where it can stop without losing anything.
    """

    def size(self, total: int) -> None:
        """Say that the work has `total` steps."""

    def advance(self, steps: int = 1) -> None:
        """Say that `steps` more steps are finished and kept."""

    def note(self, text: str) -> None:
        """Say in a few words what is being done now."""

    def cancelled(self) -> bool:
        """Return whether the user wants the work to stop."""
        return False

    def check(self) -> None:
        """Raise `Cancelled` when the user wants the work to stop."""
        if self.cancelled():
            raise Cancelled("stopped; what was finished is kept")
