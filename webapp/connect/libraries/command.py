"""`expmap connect libraries`: try the address and the API key of a photo library, and list its albums."""

from __future__ import annotations

import click

from webapp.cli.library import library_settings
from webapp.connect.libraries.records import KINDS, open_client


@click.command(short_help="Try the address and the API key of a photo library.")
@click.argument("kind", type=click.Choice(list(KINDS)))
@click.argument("address", metavar="ADDRESS")
@click.option(
    "--key",
    envvar="PHOTO_LIBRARY_KEY",
    prompt="API key",
    hide_input=True,
    help="API key; better in the variable PHOTO_LIBRARY_KEY than in the history of the shell.",
)
def libraries(kind: str, address: str, key: str) -> None:
    """Ask the photo library at ADDRESS for its albums, from this machine and by its settings."""
    client = open_client(kind, address, key=key, settings=library_settings(None).libraries)
    try:
        albums = client.albums()
    finally:
        client.http.close()
    for album in albums:
        click.echo(f"{album.items:7}  {album.name}")
    click.echo(f"{len(albums)} albums")
