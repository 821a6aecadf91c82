"""Valid names of photos and images in a map: relative, below its folder, portable between systems."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import NamedTuple

from webapp.core.mapmodel.findings import Code, quoted

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_SURROGATE = re.compile(r"[\ud800-\udfff]")
_DRIVE = re.compile(r"[A-Za-z]:")
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://|(?:file|data):", re.IGNORECASE)

_LONGEST_PART, _LONGEST = 255, 1000
"""Longest name of a file or folder on all usual file systems, and longest path, bytes."""


class NameProblem(NamedTuple):
    """Why a name is invalid in a map, and a valid alternative (or None)."""

    code: Code
    message: str
    better: str | None = None


def name_problem(name: str) -> NameProblem | None:
    """Return why `name` cannot be the path of a photo or image in a map.

    Args:
        name: Path relative to the map's folder, as in the `.cfg`.

    Returns:
        None if the name is valid. Whether the file exists is not checked.
    """
    return _unwritable(name) or _unsafe(name)


def _unwritable(name: str) -> NameProblem | None:
    if not name.strip(" "):
        return NameProblem(Code.EMPTY_NAME, "the name is empty")
    control = _CONTROL.search(name)
    if control:
        what = {"\0": "a NUL byte", "\n": "a line break", "\t": "a tab"}.get(
            control[0], "a control character"
        )
        return NameProblem(Code.CONTROL_CHARACTER, f"the name {quoted(name)} contains {what}")
    if ";" in name:
        return NameProblem(
            Code.UNWRITABLE_NAME, f"the name {quoted(name)} contains ';', which separates columns"
        )
    if _SURROGATE.search(name):
        return NameProblem(Code.UNWRITABLE_NAME, f"the name {quoted(name)} cannot be written as UTF-8")
    if name != name.strip(" ") or name.startswith("\ufeff"):
        message = f"the name {quoted(name)} begins or ends with a space or a byte order mark"
        return NameProblem(Code.UNWRITABLE_NAME, message, name.strip(" \ufeff") or None)
    if max(len(part.encode()) for part in name.split("/")) > _LONGEST_PART or len(name.encode()) > _LONGEST:
        message = f"the name {quoted(name)} is too long for most file systems"
        return NameProblem(Code.UNWRITABLE_NAME, message)
    return None


def _unsafe(name: str) -> NameProblem | None:
    if _URL.match(name):
        return NameProblem(
            Code.PATH_LEAVES_FOLDER, f"{quoted(name)} is a URL, not a file in the map's folder"
        )
    if _DRIVE.match(name) or name.startswith(("/", "\\")):
        return NameProblem(Code.PATH_LEAVES_FOLDER, f"{quoted(name)} is an absolute path")
    if ".." in name.replace("\\", "/").split("/"):
        message = f"{quoted(name)} contains '..', which can leave the map's folder"
        return NameProblem(Code.PATH_LEAVES_FOLDER, message, _without_parents(name.replace("\\", "/")))
    if "\\" in name:
        message = f"{quoted(name)} has a backslash: folders are separated by '/'"
        return NameProblem(Code.BACKSLASH_IN_PATH, message, name.replace("\\", "/"))
    return None


def _without_parents(name: str) -> str | None:
    """Return the path with '..' resolved; None if it leaves the folder anywhere."""
    parts: list[str] = []
    for part in PurePosixPath(name).parts:
        if part != "..":
            parts.append(part)
        elif parts:
            parts.pop()
        else:
            return None
    return "/".join(parts) or None
