"""`expmap connect libraries`: try the address and the API key of a photo library, and list its albums."""

from __future__ import annotations

from typing import TextIO

import click

from webapp.cli.library import library_settings
from webapp.connect.libraries.records import KINDS, open_client

_MOST = 1000
"""Characters of a file with a key."""


@click.command(short_help="Try the address and the API key of a photo library.")
@click.argument("kind", type=click.Choice(list(KINDS)))
@click.argument("address", metavar="ADDRESS")
@click.option(
    "--key-file", type=click.File(), metavar="FILE", help="File with the API key; else it is asked for."
)
def libraries(kind: str, address: str, key_file: TextIO | None) -> None:
    """Ask the photo library at ADDRESS for its albums, from this machine and by its settings."""
    key = key_file.read(_MOST) if key_file else click.prompt("API key", hide_input=True)
    client = open_client(kind, address, key=key, settings=library_settings(None).libraries)
    try:
        albums = client.albums()
    finally:
        client.http.close()
    for album in albums:
        click.echo(f"{album.items:7}  {album.name}")
    click.echo(f"{len(albums)} albums")
