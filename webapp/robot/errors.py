"""Exceptions of the client, re-exported from `webapp.errors`.

In the distribution `experience-map-robot`, `webapp/errors.py` itself replaces this file.
"""

from webapp.errors import (
    Conflict,
    DiskFull,
    ExpMapError,
    InputError,
    NotAllowed,
    NotFound,
    NotReady,
    NotSignedIn,
    StorageError,
    UsageError,
)

__all__ = [
    "Conflict",
    "DiskFull",
    "ExpMapError",
    "InputError",
    "NotAllowed",
    "NotFound",
    "NotReady",
    "NotSignedIn",
    "StorageError",
    "UsageError",
]
