"""Where the indexes of a map are, and which of them fits."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from platformdirs import user_cache_path

from webapp.core.features.table import FeatureChoice, Method, choose
from webapp.errors import IndexDamaged, UsageError
from webapp.files.listing import DERIVED
from webapp.files.localize.index_store import IndexFolder, index_key
from webapp.files.localize.models import is_usable, second_look_features
from webapp.settings import ExtractSettings


def index_bases(cfg: Path, chosen: Path | None) -> tuple[Path, ...]:
    """List the folders where a map's indexes may be; only the last is written to.

    Parameters
    ----------
    chosen : Path or None
        What the user asked for: it can serve many maps.

    Returns
    -------
    tuple of Path
        A folder of this map's in what was asked for; else in `derived` next to the map; where that cannot be
        written, it is followed by one in the user's cache.
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
    """Return the folder in which the reconstruction of a map is kept."""
    return index_bases(cfg, None)[-1] / "landmarks"


def newest_choice(
    bases: Iterable[Path],
    extract: ExtractSettings,
    *,
    method: Method,
    matcher: str | None,
    models: Path | None,
) -> FeatureChoice:
    """Resolve `auto`: the features of the newest complete index that fits, or else the best there are.

    An index does not fit where a model that is needed to ask it is not in `models`, which is None for the
    user's cache. That of the second look of method `auto`, which is built last, is taken where there is no
    other.

    Raises
    ------
    UsageError
        The matcher fits neither.
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
            continue  # a build of its features mends the one; for the other, the next may fit
    if not fitting:
        return choose(method, matcher=matcher)
    second = second_look_features(models)
    return min(fitting, key=lambda choice: choice.name == second)


def index_folder(base: Path, choice: FeatureChoice, *, extract: ExtractSettings) -> Path:
    """Name the folder of the index with these features."""
    return base / index_key(choice, extract)


def _newest_first(bases: Iterable[Path]) -> Iterator[IndexFolder]:
    manifests = [p for base in bases for p in base.glob("*/manifest.json")]
    manifests.sort(key=lambda p: -p.stat().st_mtime_ns)
    return (IndexFolder(p.parent) for p in manifests)
