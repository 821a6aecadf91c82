"""Every error a request can end with, in one tree.

::

    ExpMapError                  message, where it is, how to fix it
    ├── UsageError               the request itself cannot work (bad option, impossible combination)
    ├── NotFound                 what was asked for does not exist, or is not shared with the caller
    ├── NotSignedIn              nobody is signed in, or no longer
    ├── NotAllowed               the caller may see it, but not do this
    ├── RetryLater               the same request can succeed later
    │   ├── TooMany              too often in a short time: wait
    │   ├── Busy                 others are being served: try again
    │   │   └── BeingOpened      ... another request is opening the map
    │   ├── ClusterUnavailable   the scheduler of Dask cannot be reached, or is lost
    │   ├── FolderInUse          another process is writing there (a StorageError too)
    │   ├── DatabaseUnavailable  the database server cannot be reached, or is busy (a StorageError too)
    │   └── StorageUnavailable   the object storage cannot be reached, or refuses (a StorageError too)
    ├── Conflict                 somebody else has changed it in the meantime
    ├── NotReady                 it is still being made: later it works
    ├── MapError                 the map cannot be read as a map
    │   ├── CfgError             ... at this line and column of a .cfg
    │   └── MapJsonError         ... in map.json
    ├── InputError               one input is unusable; others may be fine
    │   ├── PhotoError           a photo
    │   ├── GeoreferenceError    corners, control points, world file, GeoTIFF
    │   ├── TableError           a CSV of queries or positions, at this line
    │   └── TrackError           a file with a track
    ├── StorageError             the disk refused: full, read-only, locked by another writer
    │   ├── DiskFull             ... because there is no space left
    │   └── ObjectLost           ... because the object storage has lost it
    ├── IndexDamaged             an index file is not what its name and manifest say
    ├── ProcessLost              a process that did a part of the work was killed
    ├── MissingPart              an optional part is not installed or not downloaded
    └── Cancelled                the user stopped it; what was finished is kept

No HTTP status and no exit code here: `cli` and `web` each hold one table for that.
An estimate that fails is not an error but a falsy value with a reason (see `core`).
"""

from __future__ import annotations


class ExpMapError(Exception):
    """A request that failed for a reason its sender can understand.

    Parameters
    ----------
    message : str
        What is wrong, in one sentence.
    where : str, optional
        File, line, field or option it is about.
    hint : str, optional
        How to fix it.
    """

    def __init__(self, message: str, *, where: str | None = None, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        self.hint = hint

    def __str__(self) -> str:
        """One line: where, what, how to fix it."""
        place = f"{self.where}: " if self.where else ""
        fix = f" ({self.hint})" if self.hint else ""
        return f"{place}{self.message}{fix}"

    def __reduce__(self) -> tuple[object, ...]:
        """Survive the way back from a worker process, keyword arguments included."""
        return _rebuild, (type(self), self.args, self.__dict__)


def _rebuild(kind: type[ExpMapError], args: tuple[str], state: dict[str, object]) -> ExpMapError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class UsageError(ExpMapError):
    """The request cannot work as it was asked."""


class NotFound(ExpMapError):
    """What was asked for does not exist, or is not shared with the caller."""


class NotAllowed(ExpMapError):
    """The caller may see it, but not do this."""


class NotSignedIn(ExpMapError):
    """Nobody is signed in, or no longer; or name or password are wrong."""


class RetryLater(ExpMapError):
    """The same request can succeed later.

    Parameters
    ----------
    wait_s : int
        Seconds after which to try again.
    """

    def __init__(
        self, message: str, *, wait_s: int, where: str | None = None, hint: str | None = None
    ) -> None:
        super().__init__(message, where=where, hint=hint)
        self.wait_s = wait_s


class TooMany(RetryLater):
    """It was tried too often in a short time."""


class Busy(RetryLater):
    """As much of this is under way as the machine can do at once."""


class BeingOpened(Busy):
    """Another request is opening the map, which takes long."""


class Conflict(ExpMapError):
    """Somebody else has changed it in the meantime; nothing was changed."""


class NotReady(ExpMapError):
    """What the request needs is still being made; later it works."""


class MapError(ExpMapError):
    """The map cannot be read as a map."""


class CfgError(MapError):
    """A `.cfg` breaks the format.

    Parameters
    ----------
    line, column : int
        Both from 1; the column counts characters.
    where : str, optional
        The file.
    """

    def __init__(
        self, message: str, *, line: int, column: int, where: str | None = None, hint: str | None = None
    ) -> None:
        place = f"{where or 'map'}:{line}:{column}"
        super().__init__(message, where=place, hint=hint)
        self.line = line
        self.column = column


class MapJsonError(MapError):
    """`map.json` breaks its schema."""


class InputError(ExpMapError):
    """One input is unusable; others of the same request may be fine."""


class PhotoError(InputError):
    """A photo is missing, damaged, too large, or not a photo."""


class GeoreferenceError(InputError):
    """Corners, control points, a world file or a GeoTIFF do not give a georeference."""


class TableError(InputError):
    """A table of queries, positions or control points has a bad line."""


class TrackError(InputError):
    """A file with a track is damaged, too large, of no known kind, or has nothing that can be used."""


class StorageError(ExpMapError):
    """The disk refused: full, read-only, or another process is writing."""


class DatabaseUnavailable(StorageError, RetryLater):
    """The database server cannot be reached, or is busy; nothing was changed, or nobody was assured of it."""


class StorageUnavailable(StorageError, RetryLater):
    """The object storage cannot be reached, is too slow or refuses; nobody was assured of anything."""


class FolderInUse(StorageError, RetryLater):
    """Another process is writing in a folder that has one writer at a time."""


class ClusterUnavailable(RetryLater):
    """The scheduler of Dask cannot be reached, or is lost; what was finished is kept."""


class ObjectLost(StorageError):
    """The object storage does not have what a file of the library stands for."""


class DiskFull(StorageError):
    """There is no space left on the disk; nothing half-written stays."""


class IndexDamaged(ExpMapError):
    """An index file is not what its name and manifest say."""


class MissingPart(ExpMapError):
    """An optional part is not installed or not downloaded; the hint says the line that gets it."""


class Cancelled(ExpMapError):
    """The user stopped the work; what was finished is kept."""


class ProcessLost(ExpMapError):
    """A worker process was killed; what was finished is kept, and a new try continues."""
