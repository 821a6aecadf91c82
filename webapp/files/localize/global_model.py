"""The model of a global descriptor, supplied by the user: `global.onnx`, and `global.json` next to it.

The JSON states what the model does not: `width`, `height`, `mean` and `std` of its input.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path

import numpy as np

from webapp.core.features.global_descriptor import GlobalDescriptor, InputForm, read_form
from webapp.errors import ExpMapError, InputError, MissingPart, StorageError
from webapp.files.atomic import read_bytes
from webapp.files.localize.models import MODELS, models_folder, read_model

_State = tuple[int, int] | None
"""Modification time and size of a file; None if it is missing."""


def global_descriptor(chosen: Path | None) -> GlobalDescriptor | None:
    """Open the model, once per process while its files do not change; None if there is none.

    Args:
        chosen: Folder with the weights, instead of the user's cache.

    Raises:
        InputError: The file holds another kind of network, or the JSON next to it is invalid.
        MissingPart: onnxruntime is not installed.
        StorageError: A file cannot be read.
    """
    model, form = model_paths(chosen)
    seen = _state_of(model)
    if seen is None:
        return None
    opened = _open(model, seen, _state_of(form))
    if isinstance(opened, ExpMapError):
        raise opened.with_traceback(None)
    return opened


def usable_global_descriptor(chosen: Path | None) -> GlobalDescriptor | None:
    """Open the model; None if it is missing or unusable (`problem` returns why)."""
    try:
        return global_descriptor(chosen)
    except (InputError, MissingPart, StorageError):
        return None


def problem(chosen: Path | None) -> str:
    """Try the model; return a sentence why it is unusable, or an empty string (also if it is missing)."""
    try:
        network = global_descriptor(chosen)
        if network is not None:
            across = np.linspace(0, 255, network.width).astype(np.uint8)
            network.describe(np.broadcast_to(across[None, :, None], (network.height, network.width, 3)))
    except (InputError, MissingPart, StorageError) as error:
        return str(error)
    return ""


def model_paths(chosen: Path | None) -> tuple[Path, Path]:
    """Return the paths of the model and of the JSON about its input."""
    path = models_folder(chosen) / MODELS["global"][0].name
    return path, path.with_suffix(".json")


@lru_cache(maxsize=2)
def _open(model: Path, seen: _State, form_seen: _State) -> GlobalDescriptor | ExpMapError:
    """Open the files in the state seen; errors are returned, so that they are cached, too."""
    try:
        data = read_model(model)
        form = _form(model.with_suffix(".json")) if form_seen is not None else InputForm()
        weights = hashlib.sha256(hashlib.sha256(data).digest() + repr(form).encode()).hexdigest()[:16]
        return GlobalDescriptor(data, file=model.name, form=form, weights=weights)
    except (InputError, MissingPart, StorageError) as error:
        return error


def _form(path: Path) -> InputForm:
    try:
        return read_form(json.loads(read_bytes(path)))
    except (ValueError, RecursionError) as error:
        reason = "it is not JSON" if isinstance(error, json.JSONDecodeError | UnicodeError) else str(error)
        hint = (
            'as in {"width": 322, "height": 322, "mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]}'
        )
        raise InputError(reason, where=path.name, hint=hint) from error


def _state_of(path: Path) -> _State:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
