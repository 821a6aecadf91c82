"""Imports by name, for what is loaded when it is needed."""

from __future__ import annotations

import gc
import importlib
from typing import Any


def import_name(reference: str) -> Any:
    """Import an object.

    Modules and classes stay, so the search for garbage pauses: it would go through all of them again and
    again, a tenth of the time that importing the web application takes.

    Parameters
    ----------
    reference : str
        "module:object".

    Raises
    ------
    ImportError
        The module does not exist.
    AttributeError
        The module has no such object.
    """
    module, name = reference.split(":")
    collecting = gc.isenabled()
    gc.disable()
    try:
        return getattr(importlib.import_module(module), name)
    finally:
        if collecting:
            gc.enable()
