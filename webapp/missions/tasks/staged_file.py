"""Track files that were uploaded for inspection, to be imported or dropped afterwards.

A staged file is in the uploads folder; its name contains the account and the size of the whole file. The
sweep of uploads deletes files that were not used for `upload.keep_hours`.
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
from webapp.files.gate import Budget
from webapp.missions.tasks import inspect_file
from webapp.missions.tasks.import_order import order_of, waiting_path
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library

_ENDING = ".track"
_ID_LENGTH = 32


@dataclass(frozen=True, slots=True)
class StagedFile:
    """A file that is being uploaded, or complete."""

    path: Path  # File with the bytes that have arrived
    size_bytes: int  # Size of the whole file

    @property
    def id(self) -> str:
        """Id, by which `find` finds the file for its account."""
        return self.path.name.partition(".")[0]

    @property
    def arrived(self) -> int:
        return part_file.arrived(self.path)


def begin(library: Library, *, name: str, size_bytes: int, account_id: int, settings: Settings) -> StagedFile:
    """Begin an upload.

    Args:
        name: Original name, for error messages.

    Raises:
        TrackError: The file is empty, or too large.
        UsageError: The account has too many staged files.
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
    """Find a file that an account has staged, and restart the period after which it is swept.

    Raises NotFound.
    """
    found = None
    if len(id) == _ID_LENGTH and id.isalnum():
        found = next(library.uploads.glob(f"{id}.{account_id}.*{_ENDING}"), None)
    if found is None:
        raise NotFound("the uploaded file no longer exists", hint="upload it again")
    os.utime(found)
    return StagedFile(found, int(found.name.split(".")[2]))


def check_complete(staged: StagedFile) -> None:
    """Check that all of a file has arrived. Raises UsageError."""
    if staged.arrived < staged.size_bytes:
        raise UsageError(
            f"{staged.arrived} of {staged.size_bytes} bytes have arrived", hint="send the rest of it first"
        )


def inspect_staged(
    staged: StagedFile, form: Mapping[str, Any], *, budget: Budget, progress: Progress | None = None
) -> dict[str, Any]:
    """Report the content of a staged file, as JSON types.

    Args:
        form: `name`, and optionally `columns`, `axes` and `source`, in the format of `order_of`.
        budget: What reading may cost.

    Raises:
        TrackError, UsageError: As `inspect_file`.
    """
    order = order_of(staged.path, form)
    try:
        report = inspect_file.inspect_file(
            staged.path, options=order.options, progress=progress, budget=budget
        )
    except TrackError as error:
        error.where = (error.where or order.name).replace(staged.path.name, order.name)
        raise
    return inspect_file.as_json(report)


def take(library: Library, staged: StagedFile) -> str:
    """Move a file to the folder of waiting imports; return the token by which the job finds it.

    Raises:
        DiskFull, StorageError: The file stays staged.
    """
    token = secrets.token_hex(16)
    part_file.move_in(staged.path, waiting_path(library, token))
    return token


def put_back(library: Library, staged: StagedFile, *, token: str) -> None:
    """Undo `take`, after the import could not be queued."""
    part_file.move_in(waiting_path(library, token), staged.path)


def drop(staged: StagedFile) -> None:
    part_file.discard(staged.path)
