"""`expmap doctor`: check an installation and a library, and say what to do."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.cli.library import library_option, library_settings
from webapp.settings import Settings
from webapp.tasks.operate import doctor as task

_SIGNS = {"ok": "ok     ", "warning": "warning", "failing": "FAILING"}


@click.command()
@library_option
@click.option(
    "--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Address to serve at."
)
@click.option(
    "--port", type=click.IntRange(1, 65535), default=8000, show_default=True, metavar="N", help="Its port."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array.")
def doctor(library: Path | None, host: str, port: int, as_json: bool) -> None:
    """Check this installation and a library, and say what to do.

    Changes nothing, and may be used while the library is served. The exit code is 1 if something fails.
    """
    checks = []
    settings = library_settings(library)
    for check in _all(settings, host, port):
        checks.append(check)
        if not as_json:
            click.echo(f"{_SIGNS[check.state]}  {check.name}: {check.message}")
            if check.hint:
                click.echo(f"         -> {check.hint}")
    if as_json:
        click.echo(json.dumps([asdict(check) for check in checks], ensure_ascii=False))
    sys.exit(SOME_FAILED if any(check.state == "failing" for check in checks) else DONE)


def _all(settings: Settings, host: str, port: int) -> Iterator[task.Check]:
    yield from task.check_installation(settings)
    yield from task.check_library(settings)
    yield from task.check_address(host, port, settings=settings)
