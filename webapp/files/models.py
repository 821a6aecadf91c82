"""Weights of networks: which files there are, where they are kept, and whether they are the right ones."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from platformdirs import user_cache_path

from webapp.core.features.xfeatnet import XFeatNetwork
from webapp.errors import MissingPart, StorageError

_FETCH = "get them with expmap models fetch"


@dataclass(frozen=True, slots=True)
class ModelFile:
    """A published file with weights.

    Attributes
    ----------
    name : str
        Of the file.
    bytes : int
    sha256 : str
    licence : str
    source : str
        Who made it, in words.
    address : str
        Where it is fetched from; empty for a file that is only taken from a folder.
    """

    name: str
    bytes: int
    sha256: str
    licence: str
    source: str
    address: str


_XFEAT_SOURCE = "XFeat of github.com/verlab/accelerated_features, as exported in github.com/meyiao/xfeatc"

MODELS: dict[str, tuple[ModelFile, ...]] = {
    "xfeat": (
        ModelFile(
            name="xfeat_800x576.onnx",
            bytes=4_106_753,
            sha256="26c77ad51d6bdbc4b9d172344a1d84e9bb6dddf6e5704815bfb21c39a586c270",
            licence="Apache-2.0",
            source=_XFEAT_SOURCE,
            address="https://raw.githubusercontent.com/meyiao/xfeatc/"
            "230ee93c5a8514216dcdc8c64f9de606b681dfb2/model/xfeat_800x576.onnx",
        ),
        ModelFile(
            name="xfeat_640x640.onnx",
            bytes=4_016_395,
            sha256="55a50801d21564c3cf5e3afe1d360dbbe8390ab3ca2c167f08d4d476504ac473",
            licence="Apache-2.0",
            source=_XFEAT_SOURCE,
            address="",
        ),
    ),
}
"""Of each model, files with the same weights: any one of them is enough. The first is the one to fetch."""


def models_folder(chosen: Path | None) -> Path:
    """Tell where weights are kept: in what was chosen, else in the user's cache."""
    return chosen or user_cache_path("experience-map") / "models"


def is_that(data: bytes, file: ModelFile) -> bool:
    """Tell whether bytes are those of a published file."""
    return len(data) == file.bytes and hashlib.sha256(data).hexdigest() == file.sha256


def installed(model: str, chosen: Path | None) -> ModelFile | None:
    """Look for a file of a model that has the right size; its content is checked when it is opened."""
    folder = models_folder(chosen)
    return next((f for f in MODELS[model] if _size(folder / f.name) == f.bytes), None)


def network(model: str | None, chosen: Path | None) -> XFeatNetwork | None:
    """Open a model, or take it as it was opened before in this process.

    Parameters
    ----------
    model : str or None
        Name in `MODELS`; None needs none.
    chosen : Path or None
        Folder with the weights, instead of the user's cache.

    Returns
    -------
    XFeatNetwork or None
        None where none is needed.

    Raises
    ------
    MissingPart
        The weights are not there, or are not what they should be.
    StorageError
        They cannot be read.
    """
    if model is None:
        return None
    file = installed(model, chosen)
    if file is None:
        raise MissingPart(f"the weights of {model} are not here", where="models", hint=_FETCH)
    return _opened(models_folder(chosen) / file.name, file)


@lru_cache(maxsize=2)
def _opened(path: Path, file: ModelFile) -> XFeatNetwork:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StorageError(f"cannot be read: {error.strerror}", where=str(path)) from error
    if not is_that(data, file):
        raise MissingPart("the file is not the published one", where=str(path), hint=_FETCH)
    return XFeatNetwork(data)


def _size(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except OSError:
        return None
