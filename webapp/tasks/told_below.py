"""Lets errors and findings name files relative to a folder: who asks over the web knows no other names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from webapp.core.mapmodel.findings import Finding
from webapp.errors import ExpMapError


@contextmanager
def told_below(folder: Path) -> Iterator[None]:
    """Take the folder out of the texts of an error that passes through."""
    try:
        yield
    except ExpMapError as error:
        error.message = below(error.message, folder)
        error.where = None if error.where is None else below(error.where, folder)
        error.hint = None if error.hint is None else below(error.hint, folder)
        raise


def finding_below(finding: Finding, folder: Path) -> Finding:
    """Take the folder out of the texts of a finding."""
    return replace(finding, message=below(finding.message, folder), fix=below(finding.fix, folder))


def below(text: str, folder: Path) -> str:
    """Take a folder out of a text."""
    return text.replace(f"{folder}{os.sep}", "")
