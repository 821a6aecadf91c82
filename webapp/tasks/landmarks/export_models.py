"""Writes the models of a map's photos for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from webapp.files.landmarks.colmap import export_model
from webapp.tasks.landmarks.mapping import model_folders
from webapp.tasks.landmarks.reconstruct import Reconstruction


@dataclass(frozen=True, slots=True)
class ExportedModel:
    """A model, and the folder that it was written to."""

    folder: Path
    photos: int
    points: int


def export_models(found: Reconstruction, out: Path) -> list[ExportedModel]:
    """Write every model into a folder of its own, with the photos called as in the map.

    Raises
    ------
    StorageError
    """
    names = {content: found.photos[number].photo for content, number in found.number_of.items()}
    exported = []
    for number, source in enumerate(model_folders(found.folder)):
        folder = out / str(number)
        exported.append(ExportedModel(folder, *export_model(source, folder, names=names)))
    return exported
