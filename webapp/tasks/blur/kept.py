"""What networks have found in photos, kept in the map's folder, so that no photo is searched twice.

A file has a line for each photo that was searched, known by its content. Lines are added and never changed,
so that what is stopped in between loses one photo at most.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from filelock import FileLock, Timeout

from webapp.core.blur import BlurBox
from webapp.core.detections import Detection
from webapp.errors import StorageError
from webapp.files.atomic import make_folder, storage_error
from webapp.files.listing import DERIVED

_WAIT_S = 20.0


class KeptFindings:
    """What was found in the photos of a map.

    Parameters
    ----------
    map_folder : Path
    key : str
        Of the networks.
    """

    def __init__(self, map_folder: Path, key: str) -> None:
        self._path = map_folder / DERIVED / "blur" / f"{key}.jsonl"

    def read(self) -> dict[str, list[Detection]]:
        """Read what was found, by the SHA-256 of the photo; a photo without anything has an empty list.

        Raises
        ------
        StorageError
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
        """Keep what was found in a photo; afterwards it is on the disk.

        Raises
        ------
        StorageError
        """
        line = json.dumps({"photo": sha256, "found": [[d.kind, list(d.box), d.score] for d in found]})
        make_folder(self._path.parent)
        try:
            lock = FileLock(self._path.with_suffix(".lock"), timeout=_WAIT_S)
            with lock, self._path.open("ab") as file:
                file.write(b"\n" + line.encode())  # ends one that was cut off
                file.flush()
                os.fsync(file.fileno())
        except Timeout as error:
            raise StorageError(
                "others keep what they find just now", where=self._path.name, hint="try again in a moment"
            ) from error
        except OSError as error:
            raise storage_error(error, where=self._path.name) from error
