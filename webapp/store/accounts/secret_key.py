"""The secret key of a library: signs sessions, and what other secrets are derived from; backups lack it."""

from __future__ import annotations

import hmac
import os
import secrets
from pathlib import Path

from filelock import FileLock

from webapp.errors import StorageError

_NAME = "secret-key"
_BYTES = 32


def secret_key(folder: Path) -> str:
    """Read the secret key, or make one if there is none; all worker processes get the same.

    Returns:
        64 hexadecimal digits.
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
    """Write the file atomically, readable only by its owner from the start."""
    temporary = path.with_name(f".{_NAME}.{os.getpid()}.tmp")
    temporary.unlink(missing_ok=True)
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="ascii") as file:
        file.write(key)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def derived_secret(folder: Path, purpose: str) -> bytes:
    """Derive a secret of 32 bytes from the key, which need not be stored: the same for the same purpose."""
    return hmac.digest(secret_key(folder).encode("ascii"), purpose.encode(), "sha256")
