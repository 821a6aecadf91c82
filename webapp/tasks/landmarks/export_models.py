"""Exports the reconstructed models of a map for other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from webapp.files.landmarks.colmap import SUBMODELS_FILE, export_model, read_submodels
from webapp.tasks.landmarks.mapping import adjusted_folders, model_folders
from webapp.tasks.landmarks.reconstruct import Reconstruction


@dataclass(frozen=True, slots=True)
class ExportedModel:
    """A model, and the folder that it was written to."""

    folder: Path
    photos: int
    points: int


def names_of_photos(found: Reconstruction) -> dict[str, str]:
    """Return the paths of the photos by the SHA-256 of their files; a view has its turn as suffix."""
    names = {content: found.photos[number].photo for content, number in found.number_of.items()}
    return names | {content: f"{names[content]}#{turn:03}" for content, turn in found.turn_of.items()}


def export_models(
    folder: Path, out: Path, *, names: Mapping[str, str], binary: bool = False, only_named: bool = False
) -> list[ExportedModel]:
    """Write each model of a reconstruction into its own folder, first the one that is joined on the map.

    Args:
        folder: Folder of the reconstruction.
        names: Names of the photos, by the SHA-256 of their files.
        binary: Whether to write COLMAP's binary format, else text.
        only_named: Whether to leave out photos without a name, with the points that only they see.

    Raises:
        IndexDamaged: A model cannot be read, or was replaced meanwhile.
        StorageError
    """
    submodels = read_submodels(folder / SUBMODELS_FILE)
    sources = [*(adjusted_folders(folder, submodels) if submodels else []), *model_folders(folder)]
    exported = []
    for number, source in enumerate(sources):
        target = out / str(number)
        counts = export_model(source, target, names=names, binary=binary, only_named=only_named)
        exported.append(ExportedModel(target, *counts))
    return exported
