"""What a calibration has found out so far, a line a photo, so that one that was killed goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from webapp.errors import StorageError
from webapp.files import atomic

Trial = dict[str, Any] | None
"""Plain values; None for a photo that cannot be used."""


@contextmanager
def resumed(path: Path, key: str) -> Iterator[tuple[dict[int, Trial], Callable[[int, Trial], None]]]:
    """Give what was written under the same key, and a function that writes another photo's trial.

    The file is removed at the end; only an error, or a process that is killed, leaves it.

    Parameters
    ----------
    key : str
        Of all that the trials depend on.

    Raises
    ------
    StorageError
    """
    known = _read(path, key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Written anew, so that a last line that is not whole is gone.
        atomic.write_text(path, "".join(_line(row) for row in (key, *([n, t] for n, t in known.items()))))
        with path.open("a", encoding="utf-8") as file:

            def append(number: int, trial: Trial) -> None:
                file.write(_line([number, trial]))
                file.flush()

            yield known, append
        path.unlink()
    except OSError as error:
        raise StorageError(f"the file cannot be written: {error.strerror}", where=str(path)) from error


def _line(row: object) -> str:
    return json.dumps(row) + "\n"


def _read(path: Path, key: str) -> dict[int, Trial]:
    found: dict[int, Trial] = {}
    try:
        first, *lines = path.read_text(encoding="utf-8").splitlines()
        if json.loads(first) != key:
            return {}
        for line in lines:
            number, trial = json.loads(line)
            found[int(number)] = trial
    except (OSError, ValueError):
        pass  # no file, or a killed writer's last line: what is before it counts
    return found
