"""Notices robots that have become silent, in missions with an alarm."""

from __future__ import annotations

import time

from webapp.missions.store import robots
from webapp.settings import Settings
from webapp.store.library import Library


def note_silences(library: Library, _settings: Settings) -> None:
    """Note which robots are silent for longer than their mission allows, each once."""
    at_s = time.time()
    with library.database.read() as session:
        if not robots.any_late(session, at_s=at_s):
            return
    with library.database.write() as session:
        robots.note_silences(session, at_s=at_s)
