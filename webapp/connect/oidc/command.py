"""`expmap connect oidc`: check the provider of the settings."""

from __future__ import annotations

import click

from webapp.cli.library import library_settings
from webapp.connect.oidc.provider import Provider, check_settings, is_set_up
from webapp.errors import NotReady
from webapp.extras import require


@click.command(short_help="Check the OpenID Connect provider of the settings.")
@click.option("--site", metavar="URL", help="Address of this server.  [default: events.site]")
def oidc(site: str | None) -> None:
    """Check the OpenID Connect provider of the settings.

    Reads its metadata and its keys, and prints the addresses that the provider has to know. Secrets are
    neither sent nor printed.
    """
    settings = library_settings(None)
    if not is_set_up(settings.oidc):
        raise NotReady("no provider is set", hint="set oidc.issuer and oidc.client_id: docs/sign-in.md")
    check_settings(settings.oidc)
    require("connect")
    provider = Provider(settings.oidc)
    found, keys = provider.metadata(), provider.keys()["keys"]
    home = (site or settings.events.site or "https://THIS-SERVER").rstrip("/")
    rows = {
        "provider": provider.issuer,
        "signs by": f"{', '.join(found.algorithms)}, {len(keys)} keys",
        "this server": f"{settings.oidc.client_id}, {found.by_secret}",
        "signs people out": "yes" if found.end_session else "no",
        "redirect address": f"{home}/oidc/callback",
        "after sign-out": f"{home}/sign-in",
    }
    for name, value in rows.items():
        click.echo(f"{name}\t{value}")
