"""Networks that detect faces and number plates to be blurred: the installed ones, and which are missing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from webapp.core.detections import LpdYuNet, ObjectDetector, YuNet
from webapp.errors import MissingPart
from webapp.files.localize.models import checked_weights, find_weights, installed

NETWORKS: dict[str, type[YuNet] | type[LpdYuNet]] = {"faces": YuNet, "plates": LpdYuNet}
"""By model name."""


@dataclass(frozen=True, slots=True)
class BlurNetworks:
    """Installed networks."""

    detectors: tuple[ObjectDetector, ...]
    key: str  # Identifies the set of networks, and so their results
    missing: tuple[str, ...]  # Models that are not installed


def blur_networks(chosen: Path | None) -> BlurNetworks:
    """Open the networks that detect faces and number plates, each once per process.

    Args:
        chosen: Folder with the weights, instead of the user's cache.

    Raises:
        MissingPart: None is installed, or a file is not the published one.
        StorageError: A file cannot be read.
    """
    missing = missing_networks(chosen)
    if len(missing) == len(NETWORKS):
        raise MissingPart(
            "no network that finds faces or number plates is installed",
            where="models",
            hint=f"the administrator of the server can install them: expmap models fetch {' '.join(missing)}",
        )
    files = {model: find_weights(model, chosen) for model in NETWORKS if model not in missing}
    detectors = tuple(_opened(model, path, file.sha256) for model, (path, file) in files.items())
    key = "-".join(file.sha256[:8] for _, file in files.values())
    return BlurNetworks(detectors, key, missing)


def missing_networks(chosen: Path | None) -> tuple[str, ...]:
    """List the models of `NETWORKS` that are not installed."""
    return tuple(model for model in NETWORKS if installed(model, chosen) is None)


@lru_cache(maxsize=2)
def _opened(model: str, path: Path, sha256: str) -> ObjectDetector:
    return NETWORKS[model](checked_weights(model, path, sha256=sha256))
