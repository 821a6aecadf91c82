"""The library, settings and parts of the application."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

from flask import Blueprint, current_app
from flask_babel import LazyString
from sqlalchemy.orm import Session

from webapp.settings import Settings
from webapp.store.library import Library

KEY = "expmap"


PublicList = Callable[[Session], Sequence[Any]]
"""Reads all public items of one kind."""


class ExportLink(NamedTuple):
    """An entry in the export menu of a map or a mission."""

    path: str  # Of its route, below that of the map or mission in the API
    label: str  # The same in all languages


class AccountPage(NamedTuple):
    """A page that the account page links to."""

    endpoint: str
    title: LazyString
    about: LazyString
    is_offered: Callable[[], bool] = lambda: True


class SignInWay(NamedTuple):
    """A way to sign in besides links and passwords."""

    endpoint: str  # GET with `next` begins it
    icon: str  # of static/img/icons.svg
    label: Callable[[], str]  # Of its button
    is_offered: Callable[[], bool]
    is_first: bool = False  # Whether it is above the form for passwords
    is_required: Callable[[], bool] = lambda: False  # Whether passwords, and links of pages, are refused
    # Called before the session of the caller ends: an address where it ends elsewhere, too.
    leave: Callable[[], str | None] = lambda: None


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of which the application is composed."""

    blueprints: tuple[Blueprint, ...]
    # Public items other than maps and answers for the page of public shares, by the name in its template.
    public_lists: Mapping[str, PublicList]
    # Descriptions of path parameters for the OpenAPI document, by name.
    path_parameters: Mapping[str, Mapping[str, Any]]
    # Parameters and bodies of routes that their schemas do not describe, by endpoint.
    operations: Mapping[str, Mapping[str, Any]]
    short_jobs: frozenset[str] = frozenset()  # Kinds of jobs that do not wait behind the others
    # Entries of the export menus of a "map" and a "mission", after those of the program itself.
    exports: Mapping[str, tuple[ExportLink, ...]] = field(default_factory=dict)
    account_pages: tuple[AccountPage, ...] = ()
    sign_in_ways: tuple[SignInWay, ...] = ()


@dataclass(frozen=True, slots=True)
class AppState:
    """State stored in the extensions of the application."""

    library: Library
    settings: Settings
    parts: Parts


def library() -> Library:
    return _state().library


def settings() -> Settings:
    return _state().settings


def parts() -> Parts:
    return _state().parts


def _state() -> AppState:
    return cast(AppState, current_app.extensions[KEY])
