"""Stores the networks' detections in the map's folder, so that no photo is searched twice.

The file has one line per searched photo, identified by its SHA-256. Lines are only appended, so that a killed
process loses one photo at most.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from filelock import FileLock, Timeout

from webapp.core.boxes import BlurBox
from webapp.core.detections import Detection
from webapp.errors import StorageError
from webapp.files.atomic import make_folder, storage_error
from webapp.files.listing import DERIVED

_WAIT_S = 20.0


class DetectionCache:
    """Stored detections of a map's photos.

    Args:
        key: Identifies the networks.
    """

    def __init__(self, map_folder: Path, key: str) -> None:
        self._path = map_folder / DERIVED / "blur" / f"{key}.jsonl"

    def read(self) -> dict[str, list[Detection]]:
        """Read the detections by the SHA-256 of the photo; the list is empty where nothing was found.

        Raises StorageError.
        """
        try:
            lines = self._path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise StorageError(f"cannot be read: {error.strerror}", where=self._path.name) from error
        found: dict[str, list[Detection]] = {}
        for line in lines:
            try:
                one = json.loads(line)
                found[one["photo"]] = [Detection(k, BlurBox(*box), score) for k, box, score in one["found"]]
            except (ValueError, KeyError, TypeError):
                continue  # cut off when a process was killed; the photo is searched again
        return found

    def add(self, sha256: str, found: Sequence[Detection]) -> None:
        """Append the detections of a photo; they are on the disk on return. Raises StorageError."""
        line = json.dumps({"photo": sha256, "found": [[d.kind, list(d.box), d.score] for d in found]})
        make_folder(self._path.parent)
        try:
            lock = FileLock(self._path.with_suffix(".lock"), timeout=_WAIT_S)
            with lock, self._path.open("ab") as file:
                file.write(b"\n" + line.encode())  # the newline ends a line that was cut off
                file.flush()
                os.fsync(file.fileno())
        except Timeout as error:
            raise StorageError(
                "another process is storing detections", where=self._path.name, hint="try again in a moment"
            ) from error
        except OSError as error:
            raise storage_error(error, where=self._path.name) from error
