"""The errors that the client raises, which are those of the program.

The distribution `experience-map-robot` has `webapp/errors.py` itself in place of this file.
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
