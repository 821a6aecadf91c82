"""What the application gives its commands; it imports neither the database nor the web."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from webapp.jobs.kinds import Duties
    from webapp.tasks.operate.backup import LibraryPart


@dataclass(frozen=True, slots=True)
class Composition:
    """The object of the root command's context.

    Attributes
    ----------
    web_app : str
        "module:function" that makes the web application, in the processes that answer requests.
    duties : callable
        Gives what a worker does.
    library_parts : callable
        Gives what a library keeps besides maps.
    """

    web_app: str
    duties: Callable[[], Duties]
    library_parts: Callable[[], Sequence[LibraryPart]]
