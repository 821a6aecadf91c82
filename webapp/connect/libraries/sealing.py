"""API keys of photo libraries, encrypted with a key derived from that of the library."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from webapp.errors import InputError
from webapp.extras import extra
from webapp.store.accounts.secret_key import derived_secret

_PURPOSE = "API keys of photo libraries"


def seal(inner: Path, key: str) -> str:
    """Encrypt an API key, for the database.

    Args:
        inner: The library's folder with its key.
    """
    return str(_cipher(inner).encrypt(key.encode()).decode("ascii"))


def unseal(inner: Path, sealed: str) -> str:
    """Decrypt an API key. Raises InputError if the library's key is another one now."""
    cipher = _cipher(inner)
    from cryptography.fernet import InvalidToken

    try:
        return str(cipher.decrypt(sealed.encode("ascii")).decode())
    except InvalidToken as error:
        raise InputError(
            "the stored API key cannot be read: this server has another secret key now",
            hint="connect the photo library again",
        ) from error


def _cipher(inner: Path) -> Any:
    with extra("connect"):
        from cryptography.fernet import Fernet

    return Fernet(base64.urlsafe_b64encode(derived_secret(inner, _PURPOSE)))
