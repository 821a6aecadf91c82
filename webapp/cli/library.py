"""The library of a command, and its accounts: `expmap account`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import click
from sqlalchemy.orm import Session

from webapp.configuration import load_settings
from webapp.errors import NotFound
from webapp.settings import Settings
from webapp.store.accounts import accounts, one_time_codes, sign_in
from webapp.store.library import Library, has_library, open_library
from webapp.store.schema import Account
from webapp.tasks.operate.open_storage import open_storage

Command = TypeVar("Command", bound=Callable[..., object])


def library_option(command: Command) -> Command:
    """Add the option `--library`."""
    return click.option(
        "--library", type=click.Path(path_type=Path), metavar="FOLDER",
        help="Folder of the maps.  [default: EXPMAP_LIBRARY, or maps]",
    )(command)  # fmt: skip


def library_settings(folder: Path | None) -> Settings:
    """Load the settings; the given folder overrides the library."""
    settings = load_settings()
    return settings if folder is None else replace(settings, library=folder)


@contextmanager
def opened_library(settings: Settings) -> Iterator[Library]:
    """Open the library of a command, with its object storage.

    Raises:
        StorageError: The records or the object storage cannot be used, or the library has another storage.
    """
    library = open_library(settings.library, url=settings.database)
    try:
        open_storage(library, settings)
        yield library
    finally:
        library.database.close()


@contextmanager
def existing_library(settings: Settings) -> Iterator[Library]:
    """Open the library of a command that does not create one.

    Raises:
        NotFound: There is no library in the folder.
        StorageError: As for `opened_library`.
    """
    if not has_library(settings.library):
        raise NotFound(
            "there is no library in this folder",
            where=str(settings.library),
            hint="set it: --library FOLDER",
        )
    with opened_library(settings) as library:
        yield library


_ADDRESS = "http://127.0.0.1:8000"


def _url_option(command: Callable[..., None]) -> Callable[..., None]:
    return click.option(
        "--url", default=_ADDRESS, show_default=True, metavar="URL", help="Address of the server."
    )(command)


def _account_option(command: Callable[..., None]) -> Callable[..., None]:
    return click.option(
        "--account", metavar="NAME", help="The account.  [default: the owner of the library]"
    )(command)


@click.command()
@_account_option
@click.option("--no-codes", is_flag=True, help="Also turn off the account's one-time codes.")
@_url_option
@library_option
def link(account: str | None, no_codes: bool, url: str, library: Path | None) -> None:
    """Print a one-time sign-in link.

    For a new user, or for one who can no longer sign in. A link asks for no password and no code of an app.
    """
    settings = load_settings()
    with _writing(library) as session:
        person = _account_named(session, account)
        token = sign_in.new_link(session, person, hours=settings.web.link_hours)
        if no_codes:
            one_time_codes.turn_off(session, person.id)
    click.echo(_link(url, token))


@click.command()
@click.option("--name", required=True, metavar="NAME", help="Name of the program that will use it.")
@click.option("--replace", "again", is_flag=True, help="Revoke an existing token of that name first.")
@_account_option
@library_option
def token(name: str, again: bool, account: str | None, library: Path | None) -> None:
    """Print a token for a program: `Authorization: Bearer TOKEN`."""
    with _writing(library) as session:
        whose = _account_named(session, account)
        for known in accounts.tokens(session, whose):
            if again and known.name == name:
                accounts.revoke_token(session, whose, token_id=known.id)
                session.flush()
        made = accounts.new_token(session, whose, name=name)
    click.echo(made)


@click.command()
@click.argument("name")
@click.option("--owner", is_flag=True, help="Make it an owner of the whole library, who may do everything.")
@_url_option
@library_option
def add(name: str, owner: bool, url: str, library: Path | None) -> None:
    """Create an account, and print a one-time sign-in link for it."""
    settings = load_settings()
    with _writing(library) as session:
        made = accounts.create(session, name, is_owner=owner)
        token = sign_in.new_link(session, made, hours=settings.web.link_hours)
    click.echo(_link(url, token))


@click.command("list")
@library_option
def list_accounts(library: Path | None) -> None:
    """List all accounts: name, whether it owns the library, and date of creation."""
    with _writing(library) as session:
        for account in accounts.list_accounts(session):
            what = "owner" if account.is_owner else "-"
            click.echo(f"{account.name}\t{what}\t{account.created_at:%Y-%m-%d}")


@contextmanager
def _writing(folder: Path | None) -> Iterator[Session]:
    with opened_library(library_settings(folder)) as library, library.database.write() as session:
        yield session


def _account_named(session: Session, name: str | None) -> Account:
    return accounts.ensure_owner(session) if name is None else accounts.named(session, name)


def _link(url: str, token: str) -> str:
    return f"{url.rstrip('/')}/sign-in/{token}"
