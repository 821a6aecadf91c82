"""Every number that can be chosen, with its unit, its default and what it is for.

The only module that reads the environment. `docs/settings.md` lists all of it; a test compares the two.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class PhotoLimits:
    """What a photo may cost before it is refused."""

    max_mb: float = 64.0
    """Size of the file, megabytes (10^6 bytes)."""

    max_megapixels: float = 120.0
    """Pixels of the decoded photo, millions."""


@dataclass(frozen=True, slots=True)
class ExtractSettings:
    """What is computed from each photo. Part of the key of an index."""

    max_side_px: int = 800
    """Photos are scaled down until the longer side has this many pixels."""

    keypoints: int = 1000
    """At most so many keypoints a photo, the strongest."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of one run."""

    photo: PhotoLimits = field(default_factory=PhotoLimits)
    extract: ExtractSettings = field(default_factory=ExtractSettings)
    library: Path = Path("maps")
    """Folder of the maps (environment: `EXPMAP_LIBRARY`)."""

    models: Path | None = None
    """Folder with model weights (environment: `EXPMAP_MODELS`)."""


def from_environment(environ: Mapping[str, str] | None = None) -> Settings:
    """Read the settings that the environment holds; all others have their defaults.

    Parameters
    ----------
    environ : mapping, optional
        Instead of the process's own environment.

    Returns
    -------
    Settings
    """
    env = os.environ if environ is None else environ
    models = env.get("EXPMAP_MODELS")
    return Settings(
        library=Path(env.get("EXPMAP_LIBRARY") or "maps"), models=Path(models) if models else None
    )


def let_threads_sleep() -> None:
    """Have OpenMP's threads sleep while they wait for each other; it reads this when it is loaded.

    By default they wait in a busy loop: where other programs want the cores too, a search took thirty times
    as long. Who set `OMP_WAIT_POLICY` is not overruled.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
