"""What the application was made with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

from flask import current_app

from webapp.settings import Settings
from webapp.store.library import Library

KEY = "expmap"


@dataclass(frozen=True, slots=True)
class State:
    """Kept in the extensions of the application.

    Attributes
    ----------
    library : Library
    settings : Settings
    """

    library: Library
    settings: Settings


def library() -> Library:
    """Give the library of this application."""
    return _state().library


def settings() -> Settings:
    """Give the settings of this application."""
    return _state().settings


def _state() -> State:
    return cast(State, current_app.extensions[KEY])
