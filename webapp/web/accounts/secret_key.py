"""The key that signs sessions: made once, kept in the library."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from filelock import FileLock

from webapp.errors import StorageError

_NAME = "secret-key"
_BYTES = 32


def secret_key(folder: Path) -> str:
    """Read the key, or make it where there is none; all worker processes get the same.

    Parameters
    ----------
    folder : Path
        The inner folder of a library.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    StorageError
        The file cannot be written, or holds something else.
    """
    path = folder / _NAME
    try:
        with FileLock(folder / f"{_NAME}.lock"):
            if not path.exists():
                _write(path, secrets.token_hex(_BYTES))
        key = path.read_text("ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise StorageError(f"the secret key cannot be kept: {error}", where=str(path)) from error
    if len(key) != 2 * _BYTES:
        raise StorageError(
            "this is not a valid secret key",
            where=str(path),
            hint="delete it: everybody has to sign in again",
        )
    return key


def _write(path: Path, key: str) -> None:
    """Write under the name only what is complete, and readable by nobody else from the start."""
    temporary = path.with_name(f".{_NAME}.{os.getpid()}.tmp")
    temporary.unlink(missing_ok=True)
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="ascii") as file:
        file.write(key)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
