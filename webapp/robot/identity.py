"""Whose a spool is: the file `spool.json` in its folder."""

from __future__ import annotations

import json
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

from webapp.errors import InputError, UsageError
from webapp.robot.disk import told, write_whole

_FORMAT = 1


@dataclass(frozen=True, slots=True)
class Identity:
    """Whose a spool is.

    Attributes
    ----------
    id : str
        The sender's name at the server.
    mission : int
    url : str
        Of the server.
    about : str
        What fills it; a spool is not continued with something else.
    """

    id: str
    mission: int
    url: str
    about: str


def read_identity(folder: Path) -> Identity:
    """Read whose a spool is.

    Raises
    ------
    UsageError
        There is no spool.
    InputError
        It is damaged, or of a newer program.
    """
    path = folder / "spool.json"
    if not path.is_file():
        raise UsageError(
            "there is no spool in this folder", where=str(folder), hint="name the folder of a spool"
        )
    try:
        told_here = json.loads(path.read_text("utf-8"))
        if told_here["format"] != _FORMAT:
            raise InputError("the spool is of a newer program", where=str(path), hint="update this program")
        return Identity(*(told_here[name] for name in ("id", "mission", "url", "about")))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("the file is damaged", where=str(path), hint="restore it from a copy") from error


def take_over(folder: Path, wanted: Identity | None) -> Identity:
    """Read whose a spool is, or write it where there is none yet.

    Parameters
    ----------
    folder : Path
    wanted : Identity or None
        Its `id` is not looked at; None where there must be a spool.

    Raises
    ------
    UsageError
        The spool is another mission's, or about something else.
    InputError
        `spool.json` is damaged or missing.
    """
    if not (folder / "spool.json").exists() and wanted is not None:
        if any(folder.glob("records-*.log")):
            raise InputError("spool.json is missing", where=str(folder), hint="restore it from a copy")
        made = Identity(uuid.uuid4().hex, wanted.mission, wanted.url, wanted.about)
        _write(folder, made)
        return made
    found = read_identity(folder)
    if wanted is None:
        return found
    if found.mission != wanted.mission:
        raise UsageError(
            f"the spool is of mission {found.mission}, not {wanted.mission}",
            where=str(folder),
            hint="choose another folder",
        )
    if found.about != wanted.about:
        raise UsageError(
            f"the spool holds something else: {found.about or 'what a robot sent'}",
            where=str(folder),
            hint="choose another folder",
        )
    if found.url != wanted.url:
        found = Identity(found.id, found.mission, wanted.url, found.about)
        _write(folder, found)
    return found


def _write(folder: Path, identity: Identity) -> None:
    told_there = {
        "format": _FORMAT,
        "id": identity.id,
        "mission": identity.mission,
        "url": identity.url,
        "about": identity.about,
        "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    with told(folder):
        write_whole(folder / "spool.json", json.dumps(told_there, indent=2).encode("utf-8"))
