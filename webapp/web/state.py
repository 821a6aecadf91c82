"""What the application was made with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from flask import Blueprint, current_app
from sqlalchemy.orm import Session

from webapp.settings import Settings
from webapp.store.library import Library

KEY = "expmap"


PublicList = Callable[[Session], Sequence[Any]]
"""Reads what of one kind is open to everybody."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What the application is put together of.

    Attributes
    ----------
    public_lists : mapping of str to callable
        What the page of public content lists besides maps and answers, by the name its template has for it.
    path_parameters : mapping of str to mapping
        Parts of addresses, as the OpenAPI document describes them, by name.
    operations : mapping of str to mapping
        What routes read that no schema of theirs describes, by endpoint.
    """

    blueprints: tuple[Blueprint, ...]
    public_lists: Mapping[str, PublicList]
    path_parameters: Mapping[str, Mapping[str, Any]]
    operations: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class AppState:
    """Kept in the extensions of the application."""

    library: Library
    settings: Settings
    parts: Parts


def library() -> Library:
    """Return the library of this application."""
    return _state().library


def settings() -> Settings:
    """Return the settings of this application."""
    return _state().settings


def parts() -> Parts:
    """Return the parts of this application."""
    return _state().parts


def _state() -> AppState:
    return cast(AppState, current_app.extensions[KEY])
