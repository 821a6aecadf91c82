"""Where the indexes of a map are, and which of them fits."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from platformdirs import user_cache_path

from webapp.core.features.table import FeatureChoice, Method, choose
from webapp.errors import IndexDamaged
from webapp.files.indexstore import IndexFolder, index_key
from webapp.settings import ExtractSettings

DERIVED = "derived"


def index_base(cfg: Path, chosen: Path | None) -> Path:
    """Choose the folder that holds a map's indexes.

    Parameters
    ----------
    cfg : Path
    chosen : Path or None
        What the user asked for.

    Returns
    -------
    Path
        What was asked for; else `derived` beside the map; else, where that cannot be written, a folder of
        its own in the user's cache.
    """
    if chosen is not None:
        return chosen
    beside = cfg.parent / DERIVED
    if os.access(beside if beside.exists() else cfg.parent, os.W_OK):
        return beside
    name = hashlib.sha256(os.fsencode(cfg.resolve())).hexdigest()[:16]
    return user_cache_path("experience-map") / "indexes" / f"{cfg.stem}-{name}"


def newest_choice(
    base: Path, extract: ExtractSettings, *, method: Method, matcher: str | None
) -> FeatureChoice:
    """Resolve `auto`: the features of the newest complete index, or the best there are when there is none.

    Raises
    ------
    UsageError
        The matcher does not fit those features.
    """
    for folder in _newest_first(base):
        try:
            manifest = folder.read_manifest()
        except IndexDamaged:
            continue  # a build of these features will say so
        if manifest is not None and manifest.extract == extract:
            return choose(method, detector=manifest.detector, extractor=manifest.extractor, matcher=matcher)
    return choose(method, matcher=matcher)


def index_folder(base: Path, choice: FeatureChoice, *, extract: ExtractSettings) -> Path:
    """Name the folder of the index with these features."""
    return base / index_key(choice, extract)


def _newest_first(base: Path) -> Iterator[IndexFolder]:
    manifests = sorted(base.glob("*/manifest.json"), key=lambda p: -p.stat().st_mtime_ns)
    return (IndexFolder(p.parent) for p in manifests)
