"""`expmap connect passkeys`: list or remove the passkeys of an account."""

from __future__ import annotations

from pathlib import Path

import click

from webapp.cli.library import existing_library, library_option, library_settings
from webapp.store.accounts import accounts, passkeys


@click.command("passkeys", short_help="List or remove the passkeys of an account.")
@click.argument("account")
@click.option("--remove", is_flag=True, help="Remove all of them, for example after a theft.")
@library_option
def passkeys_command(account: str, remove: bool, library: Path | None) -> None:
    """List the passkeys of ACCOUNT: name, date of creation and of last use."""
    with existing_library(library_settings(library)) as opened, opened.database.write() as session:
        for one in passkeys.of_account(session, accounts.named(session, account).id):
            used = f"{one.used_at:%Y-%m-%d}" if one.used_at else "never"
            click.echo(f"{one.name}\t{one.created_at:%Y-%m-%d}\t{'removed' if remove else used}")
            if remove:
                session.delete(one)
