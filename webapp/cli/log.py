"""The option of commands that run for long and write a log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from webapp.jobs.logs import FORMS

Command = Callable[..., Any]


def log_option(command: Command) -> Command:
    """Add the form of the log."""
    return click.option(
        "--log", type=click.Choice(FORMS), default="text", show_default=True,
        help="Form of the log on standard error.",
    )(command)  # fmt: skip
