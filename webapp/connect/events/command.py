"""`expmap connect events`: a test message by the settings for e-mail."""

from __future__ import annotations

import click

from webapp.cli.library import library_settings
from webapp.connect.events import mail


@click.command(short_help="Send a test message by the settings for e-mail.")
@click.argument("address", metavar="ADDRESS")
def events(address: str) -> None:
    """Send a test message to ADDRESS by the settings for e-mail, and say what the mail server says."""
    settings = library_settings(None)
    to = mail.check_address(address)
    text = "This server can send e-mail.\n"
    message = mail.compose(settings.mail, to, subject="A test message of Experience Map", text=text)
    mail.send(settings.mail, message, timeout_s=settings.events.timeout_s)
    click.echo(f"the mail server has accepted a message to {to}")
