"""Lists the installed weights of networks, and fetches missing ones."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.features.entry import ModelFile
from webapp.errors import InputError, NotFound, StorageError, UsageError
from webapp.files import atomic
from webapp.files.localize import global_model
from webapp.files.localize.models import MODELS, install_hint, matches_hash, models_folder
from webapp.net.download import download
from webapp.progress import Progress
from webapp.settings import Settings

Models = Mapping[str, tuple[ModelFile, ...]]


@dataclass(frozen=True, slots=True)
class ModelState:
    """A file with weights, and whether it is installed."""

    model: str  # Name of features, or of a network that matches them
    file: ModelFile
    # "here", "missing", "damaged" or "unusable". Files supplied by the user are never "damaged", as they have
    # no known hash; that of a global descriptor is loaded as a test.
    state: str
    problem: str = ""  # Why it is unusable


def states(settings: Settings, *, models: Models = MODELS) -> list[ModelState]:
    """Check which weights are installed, by their hashes, and whether a global descriptor can be used."""
    folder = models_folder(settings.models)
    found = [ModelState(name, f, _state(folder / f.name, f)) for name, files in models.items() for f in files]
    problem = global_model.problem(settings.models)
    return [
        replace(s, state="unusable", problem=problem) if problem and s.model == "global" else s for s in found
    ]


def missing(names: Collection[str], *, settings: Settings, models: Models = MODELS) -> list[str]:
    """List the models with published files that are not installed.

    Args:
        names: Models; if empty, all with published files.

    Raises:
        UsageError: A name is unknown, or the model has no published file.
    """
    unknown = next((name for name in names if name not in models), None)
    if unknown is not None:
        raise UsageError(f"unknown model {unknown!r}", where="models", hint=f"known: {', '.join(models)}")
    wanted = [name for name in models if name in names or (not names and models[name][0].published)]
    own = next((models[name][0] for name in wanted if not models[name][0].published), None)
    if own is not None:
        hint = install_hint(own)
        raise UsageError("no published file is pinned, so none is fetched", where=own.name, hint=hint)
    folder = models_folder(settings.models)
    return [name for name in wanted if all(_state(folder / f.name, f) != "here" for f in models[name])]


def is_available(name: str, source: Path | None, *, models: Models = MODELS) -> bool:
    """Check whether a folder has a file of a model; without a folder, whether it has a download address."""
    if source is None:
        return bool(models[name][0].address)
    return any((source / file.name).is_file() for file in models[name])


def choose_file(name: str, source: Path | None, *, models: Models = MODELS) -> ModelFile:
    """Choose which of a model's files to fetch; separate from `fetch`, to show the licence first.

    Args:
        source: Folder to copy it from; None to download it.

    Raises:
        NotFound: The folder has none of them.
        UsageError: It has no download address.
    """
    files = models[name]
    if source is None:
        if not files[0].address:
            hint = install_hint(files[0])
            raise UsageError("no trusted download address is known", where=files[0].name, hint=hint)
        return files[0]
    found = next((file for file in files if (source / file.name).is_file()), None)
    if found is None:
        wanted = " or ".join(file.name for file in files)
        raise NotFound(f"the folder has no {wanted}", where=str(source), hint=f"it is from {files[0].source}")
    return found


def fetch(file: ModelFile, source: Path | None, *, settings: Settings, progress: Progress) -> Path:
    """Download a file, or copy it from a folder; only the published file is accepted, by its hash.

    Args:
        source: Folder with the file; None to download it.

    Returns:
        The file.

    Raises:
        InputError: The content differs from the published file.
        StorageError, Cancelled
    """
    if source is not None:
        came_from = str(source / file.name)
        data = atomic.read_bytes(source / file.name)
    else:
        came_from = file.address
        data = download(file.address, size=file.bytes, progress=progress)
    if not matches_hash(data, file):
        raise InputError(
            "this is not the published file, and was not kept",
            where=came_from,
            hint=f"it should have {file.bytes} bytes and SHA-256 {file.sha256}",
        )
    target = models_folder(settings.models) / file.name
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be created: {error.strerror}", where=str(target.parent)) from error
    atomic.write_bytes(target, data)
    return target


def _state(path: Path, file: ModelFile) -> str:
    if not file.published:
        return "here" if path.is_file() else "missing"
    try:
        return "here" if matches_hash(path.read_bytes(), file) else "damaged"
    except OSError:
        return "missing"
