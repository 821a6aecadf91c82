"""Finds the indexes of a map, and the one to use."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from platformdirs import user_cache_path

from webapp.core.features.table import FeatureChoice, Method, choose
from webapp.errors import IndexDamaged, UsageError
from webapp.files import contents
from webapp.files.landmarks.cloud import CLOUD_FILE
from webapp.files.listing import DERIVED
from webapp.files.localize.index_store import IndexFolder, index_key
from webapp.files.localize.models import is_usable, second_look_features
from webapp.settings import ExtractSettings


def index_bases(cfg: Path, chosen: Path | None) -> tuple[Path, ...]:
    """Return the possible folders of a map's indexes; only the last one is written to.

    Args:
        chosen: Folder chosen by the user, which can contain indexes of many maps.

    Returns:
        The map's folder in `chosen`; by default the one in `derived` next to the map, followed by one in the
            user's cache if that cannot be written.
    """
    elsewhere = f"{cfg.stem}-{hashlib.sha256(os.fsencode(cfg.resolve())).hexdigest()[:16]}"
    if chosen is not None:
        return (chosen / elsewhere,)
    local = cfg.parent / DERIVED / cfg.stem
    existing = next(p for p in (local, *local.absolute().parents) if p.exists())
    if os.access(existing, os.W_OK):
        return (local,)
    return (local, user_cache_path("experience-map") / "indexes" / elsewhere)


def landmarks_folder(cfg: Path) -> Path:
    """Return the folder of a map's reconstruction."""
    return index_bases(cfg, None)[-1] / "landmarks"


def has_landmarks(cfg: Path) -> bool:
    """Return whether a map has a stored cloud of landmarks."""
    return contents.is_there(landmarks_folder(cfg) / CLOUD_FILE)


def newest_choice(
    bases: Iterable[Path],
    extract: ExtractSettings,
    *,
    method: Method,
    matcher: str | None,
    models: Path | None,
) -> FeatureChoice:
    """Resolve `auto`: the features of the newest index that can be used, or else the method's default.

    An index cannot be used if a model that queries need is missing from `models` (None: the user's cache).
    The index of the second look of `auto`, which is built last, is used only if there is no other.

    Raises:
        UsageError: The matcher does not fit any of them.
    """
    fitting = []
    for folder in _newest_first(bases):
        try:
            manifest = folder.read_manifest()
            if manifest is not None and manifest.extract == extract:
                choice = choose(
                    method, detector=manifest.detector, extractor=manifest.extractor, matcher=matcher
                )
                if is_usable(choice, models, method=method):
                    fitting.append(choice)
        except (IndexDamaged, UsageError):
            continue  # damaged (a build repairs it), or not for this method: try the next one
    if not fitting:
        return choose(method, matcher=matcher)
    second = second_look_features(models)
    return min(fitting, key=lambda choice: choice.name == second)


def index_folder(base: Path, choice: FeatureChoice, *, extract: ExtractSettings) -> Path:
    """Return the folder of the index with these features."""
    return base / index_key(choice, extract)


def _newest_first(bases: Iterable[Path]) -> Iterator[IndexFolder]:
    manifests = [p for base in bases for p in base.glob("*/manifest.json")]
    manifests.sort(key=lambda p: -p.stat().st_mtime_ns)
    return (IndexFolder(p.parent) for p in manifests)
