"""`expmap settings`: print the value of each setting and where it comes from."""

from __future__ import annotations

import json

import click

from webapp.configuration import Effective, effective_settings

_SECRET = {
    "database",
    "mail.password",
    "oidc.client_secret",
    "serve.metrics_token",
    "street.mapillary_token",
    "token",
}


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def settings(as_json: bool) -> None:
    """Print the value of each setting and where it comes from.

    To choose a settings file, write --config FILE before the command, or set EXPMAP_CONFIG.
    """
    found = effective_settings()
    if as_json:
        click.echo(json.dumps([_as_json(one) for one in found], indent=1))
        return
    rows = [(one.setting.key, _shown(one), one.setting.variables[0], one.source) for one in found]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo("  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


def _shown(one: Effective) -> str:
    if one.value is None:
        return "none"
    return "(secret)" if one.setting.key in _SECRET else str(one.value)


def _as_json(one: Effective) -> dict[str, object]:
    number = one.value is None or isinstance(one.value, int | float)
    return {
        "setting": one.setting.key,
        "value": one.value if number else _shown(one),
        "variable": one.setting.variables[0],
        "source": one.source,
    }
