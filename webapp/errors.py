"""All errors with which a request can end, as one class hierarchy.

::

    ExpMapError                  message, location, how to fix it
    ├── UsageError               the request itself cannot work (bad option, impossible combination)
    ├── NotFound                 the requested item does not exist, or is not shared with the caller
    ├── NotSignedIn              the caller is not signed in, or the session has expired
    ├── NotAllowed               the caller may see the item, but not do this with it
    ├── RetryLater               the same request can succeed later
    │   ├── TooMany              too many requests in a short time: wait
    │   ├── Busy                 the server is at its capacity: try again
    │   │   └── BeingOpened      ... another request is opening the map
    │   ├── ClusterUnavailable   the Dask scheduler cannot be reached, or is lost
    │   ├── FolderInUse          another process is writing there (a StorageError too)
    │   ├── DatabaseUnavailable  the database server cannot be reached, or is busy (a StorageError too)
    │   └── StorageUnavailable   the object storage cannot be reached, or refuses (a StorageError too)
    ├── Conflict                 another user or process has changed the item in the meantime
    ├── NotReady                 something that the request needs is still being made or is missing
    ├── MapError                 the map cannot be read as a map
    │   ├── CfgError             ... at this line and column of a .cfg
    │   └── MapJsonError         ... in map.json
    ├── InputError               one input is unusable; others may be fine
    │   ├── PhotoError           a photo
    │   ├── GeoreferenceError    corners, control points, world file, GeoTIFF
    │   ├── TableError           a CSV of queries or positions, at this line
    │   └── TrackError           a file with a track
    │       └── TooSlow          ... that takes more time to read than it may
    ├── StorageError             reading or writing failed: disk full, read-only, damaged, locked
    │   ├── DiskFull             ... because there is no space left
    │   ├── DiskReadOnly         ... because the disk is read-only
    │   └── ObjectLost           ... because the object storage has lost an object
    ├── IndexDamaged             an index file does not match its name or manifest
    ├── ProcessLost              a process that did a part of the work was killed
    ├── MissingPart              an optional part is not installed or not downloaded
    └── Cancelled                the user stopped the work; finished parts are kept

HTTP statuses and exit codes are not defined here: `cli` and `web` have a table each.
A failed estimate is not an error but a falsy value with a reason (see `core`).
"""

from __future__ import annotations


class ExpMapError(Exception):
    """A request failed for a reason that the user can understand.

    Args:
        message: The problem, in one sentence.
        where: File, line, field or option concerned.
        hint: How to fix it.
    """

    def __init__(self, message: str, *, where: str | None = None, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        self.hint = hint

    def __str__(self) -> str:
        """Return one line: location, message, how to fix it."""
        place = f"{self.where}: " if self.where else ""
        fix = f" ({self.hint})" if self.hint else ""
        return f"{place}{self.message}{fix}"

    def __reduce__(self) -> tuple[object, ...]:
        """Make the error picklable with its keyword arguments, so that worker processes can raise it."""
        return _rebuild, (type(self), self.args, self.__dict__)


def _rebuild(kind: type[ExpMapError], args: tuple[str], state: dict[str, object]) -> ExpMapError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class UsageError(ExpMapError):
    """The request itself cannot work: a bad option or an impossible combination."""


class NotFound(ExpMapError):
    """The requested item does not exist, or is not shared with the caller."""


class NotAllowed(ExpMapError):
    """The caller may see the item, but not do this with it."""


class NotSignedIn(ExpMapError):
    """The caller is not signed in, the session has expired, or the name or password is wrong."""


class RetryLater(ExpMapError):
    """The same request can succeed later."""

    def __init__(
        self, message: str, *, wait_s: int, where: str | None = None, hint: str | None = None
    ) -> None:
        super().__init__(message, where=where, hint=hint)
        self.wait_s = wait_s


class TooMany(RetryLater):
    """Too many requests in a short time."""


class Busy(RetryLater):
    """The server already processes as many requests of this kind as it can."""


class BeingOpened(Busy):
    """Another request is still opening the map, which takes a while."""


class Conflict(ExpMapError):
    """Another user or process has changed the item in the meantime; this request changed nothing."""


class NotReady(ExpMapError):
    """Something that the request needs is still being made or is missing."""


class MapError(ExpMapError):
    """The map cannot be read as a map."""


class CfgError(MapError):
    """A `.cfg` violates the format.

    Args:
        line, column: Counted from 1; columns are characters.
        where: The file.
    """

    def __init__(
        self, message: str, *, line: int, column: int, where: str | None = None, hint: str | None = None
    ) -> None:
        place = f"{where or 'map'}:{line}:{column}"
        super().__init__(message, where=place, hint=hint)
        self.line = line
        self.column = column


class MapJsonError(MapError):
    """`map.json` violates its schema."""


class InputError(ExpMapError):
    """One input is unusable; others of the same request may be fine."""


class PhotoError(InputError):
    """A photo is missing, damaged, too large, or not a photo."""


class GeoreferenceError(InputError):
    """Corners, control points, a world file or a GeoTIFF do not give a georeference."""


class TableError(InputError):
    """A table of queries, positions or control points has a bad line."""


class TrackError(InputError):
    """A file with a track is damaged, too large, of an unknown format, or has nothing usable."""


class TooSlow(TrackError):
    """A file with a track takes more time to be read than the settings allow."""


class StorageError(ExpMapError):
    """Reading or writing failed: storage full, read-only or damaged, or another process is writing."""


class DatabaseUnavailable(StorageError, RetryLater):
    """The database server cannot be reached, or is busy; nothing was changed, or at least not confirmed."""


class StorageUnavailable(StorageError, RetryLater):
    """The object storage cannot be reached, is too slow or refuses; no change was reported as successful."""


class FolderInUse(StorageError, RetryLater):
    """Another process is writing in a folder that allows one writer at a time."""


class ClusterUnavailable(RetryLater):
    """The Dask scheduler cannot be reached, or is lost; finished parts are kept."""


class ObjectLost(StorageError):
    """The object storage lacks the object that a file of the library refers to."""


class DiskFull(StorageError):
    """There is no space left on the disk; partly written files are removed."""


class DiskReadOnly(StorageError):
    """The disk is mounted read-only, perhaps by the system after an error; what is there can be read."""


class IndexDamaged(ExpMapError):
    """An index file does not match its name or manifest."""


class MissingPart(ExpMapError):
    """An optional part is not installed or not downloaded; the hint is the command that gets it."""


class Cancelled(ExpMapError):
    """The user stopped the work; finished parts are kept."""


class ProcessLost(ExpMapError):
    """A worker process was killed; finished parts are kept, and a retry continues from them."""
