"""Makes paths in errors and findings relative to a folder: web users must not see absolute ones."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from webapp.core.mapmodel.findings import Finding
from webapp.errors import ExpMapError


@contextmanager
def show_relative_to(folder: Path) -> Iterator[None]:
    """Make paths below the folder relative in errors that are raised in the block."""
    try:
        yield
    except ExpMapError as error:
        error.message = relative_text(error.message, folder)
        error.where = None if error.where is None else relative_text(error.where, folder)
        error.hint = None if error.hint is None else relative_text(error.hint, folder)
        raise


def relative_finding(finding: Finding, folder: Path) -> Finding:
    return replace(
        finding, message=relative_text(finding.message, folder), fix=relative_text(finding.fix, folder)
    )


def relative_text(text: str, folder: Path) -> str:
    return text.replace(f"{folder}{os.sep}", "")
