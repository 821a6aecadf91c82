"""Lazy imports by name."""

from __future__ import annotations

import gc
import importlib
from typing import Any


def import_name(reference: str) -> Any:
    """Import an object.

    The garbage collector is paused, as modules and classes are never freed: scanning them repeatedly takes a
    tenth of the time of importing the web application.

    Args:
        reference: "module:object".
    """
    module, name = reference.split(":")
    collecting = gc.isenabled()
    gc.disable()
    try:
        return getattr(importlib.import_module(module), name)
    finally:
        if collecting:
            gc.enable()
