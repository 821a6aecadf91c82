"""Files with tracks that were uploaded to be looked at: each is imported or dropped, or swept away later.

A staged file is in the uploads folder, under a name that says whose it is and how long it will be. Who does
not come back leaves nothing behind: the sweep of uploads deletes what was not used for `upload.keep_hours`.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from webapp.errors import NotFound, TrackError, UsageError
from webapp.files import part_file
from webapp.missions.tasks import inspect_file
from webapp.missions.tasks.import_order import order_of, waiting_path
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library

_ENDING = ".track"
_ID_LENGTH = 32


@dataclass(frozen=True, slots=True)
class StagedFile:
    """A file on its way in.

    Attributes
    ----------
    path : Path
        What has arrived of it.
    size_bytes : int
        Of the whole file.
    """

    path: Path
    size_bytes: int

    @property
    def id(self) -> str:
        """By which its account finds it."""
        return self.path.name.partition(".")[0]

    @property
    def arrived(self) -> int:
        """Bytes that have arrived."""
        return part_file.arrived(self.path)


def begin(library: Library, *, name: str, size_bytes: int, account_id: int, settings: Settings) -> StagedFile:
    """Begin an upload.

    Parameters
    ----------
    name : str
        As its sender calls it, for errors.

    Raises
    ------
    TrackError
        It is empty, or too large.
    UsageError
        The account has begun too many.
    DiskFull
    """
    if size_bytes == 0:
        raise TrackError("the file is empty", where=name)
    most_mb, most = settings.web.max_request_mb, settings.upload.open_per_account
    if size_bytes > most_mb * 1e6:
        raise TrackError(
            f"the file has {size_bytes / 1e6:.0f} MB, and the limit is {most_mb:g} MB",
            where=name,
            hint="import it with `expmap mission import`",
        )
    if sum(1 for _ in library.uploads.glob(f"*.{account_id}.*{_ENDING}")) >= most:
        raise UsageError(
            f"{most} files are already waiting to be imported", hint="import or drop some of them first"
        )
    part_file.check_space(library.uploads, size_bytes, reserve_mb=settings.upload.reserve_mb)
    path = library.uploads / f"{secrets.token_hex(_ID_LENGTH // 2)}.{account_id}.{size_bytes}{_ENDING}"
    path.touch()
    return StagedFile(path, size_bytes)


def find(library: Library, id: str, *, account_id: int) -> StagedFile:
    """Find a file that an account has staged, and keep it from being swept away for now.

    Raises
    ------
    NotFound
    """
    found = None
    if len(id) == _ID_LENGTH and id.isalnum():
        found = next(library.uploads.glob(f"{id}.{account_id}.*{_ENDING}"), None)
    if found is None:
        raise NotFound("the uploaded file no longer exists", hint="upload it again")
    os.utime(found)
    return StagedFile(found, int(found.name.split(".")[2]))


def check_complete(staged: StagedFile) -> None:
    """Refuse a file of which a part is missing.

    Raises
    ------
    UsageError
    """
    if staged.arrived < staged.size_bytes:
        raise UsageError(
            f"{staged.arrived} of {staged.size_bytes} bytes have arrived", hint="send the rest of it first"
        )


def inspect_staged(
    staged: StagedFile, form: Mapping[str, Any], *, progress: Progress | None = None
) -> dict[str, Any]:
    """Say what is in a staged file, as JSON has it.

    Parameters
    ----------
    form : mapping
        `name`, and where they are known `columns`, `axes` and `source`, as `order_of` reads them.

    Raises
    ------
    TrackError, UsageError
        As `inspect_file`.
    """
    order = order_of(staged.path, form)
    try:
        report = inspect_file.inspect_file(staged.path, options=order.options, progress=progress)
    except TrackError as error:
        error.where = (error.where or order.name).replace(staged.path.name, order.name)
        raise
    return inspect_file.as_json(report)


def take(library: Library, staged: StagedFile) -> str:
    """Move a file to where imports wait; gives the token by which its job finds it.

    Raises
    ------
    DiskFull, StorageError
        It stays staged.
    """
    token = secrets.token_hex(16)
    part_file.move_in(staged.path, waiting_path(library, token))
    return token


def put_back(library: Library, staged: StagedFile, *, token: str) -> None:
    """Undo `take`: the import was not queued."""
    part_file.move_in(waiting_path(library, token), staged.path)


def drop(staged: StagedFile) -> None:
    """Delete a file that nobody wants to import."""
    part_file.discard(staged.path)
