"""A map that is open for localization."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from webapp.core.features.table import FeatureChoice, Method
from webapp.core.landmarks.cloud import AlignedCloud
from webapp.core.mapmodel.accuracy import inexact_positions
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import LevelView, experience_of
from webapp.core.mapmodel.views import level_views, picture_name
from webapp.core.retrieval.indexed import IndexedMap
from webapp.files.localize.index_store import IndexFolder, Manifest
from webapp.settings import Settings
from webapp.tasks.localize.plan import LookPlan


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What a build did."""

    folder: Path  # Index folder
    photos: int  # Photos in the map
    # `extracted`, `reused`, `removed`: Photos extracted now, taken from the old index, and no longer in the
    # map.
    extracted: int
    reused: int
    removed: int
    failed: tuple[tuple[int, str, str], ...]  # Experience id, photo and reason
    descriptors: int  # Descriptors in the index that belong to photos in the map
    seconds: float
    bytes: int  # Size on disk


@dataclass(frozen=True, slots=True, eq=False)
class OpenMap:
    """A map ready for localization."""

    cfg: Path
    map: Map
    choice: FeatureChoice
    folder: IndexFolder
    # Folder for files computed from the index: the index folder, or one in the cache if that is read-only.
    writable: Path
    manifest: Manifest
    indexed: IndexedMap
    built: BuildReport | None  # Set if the index had to be built or updated
    plan: LookPlan
    settings: Settings
    landmarks: AlignedCloud | None = None  # For method `landmarks`
    # The indexed pictures: photos, and the level views of panoramas.
    pictures: tuple[Experience, ...] = field(init=False)
    views: Mapping[int, LevelView] = field(init=False)  # The level views among the pictures, by id
    # 68 % radii of the experiences with inexact positions, by id.
    position_radius_px: Mapping[int, float] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pictures", pictures := level_views(self.map.experiences))
        object.__setattr__(self, "views", {e.id: e.view for e in pictures if e.view is not None})
        object.__setattr__(self, "position_radius_px", inexact_positions(self.map))

    @property
    def method(self) -> Method:
        """Method that the map is opened for; not `auto`."""
        return self.plan.method

    def artifact_paths(self, name: str) -> tuple[Path, Path]:
        """Return the paths of a file computed from the index: next to the index, and where it is written."""
        return self.folder.folder / name, self.writable / name

    @property
    def contents(self) -> list[str]:
        """Content hash of each picture, in the map's order; empty if it is not in the index."""
        return contents_of(self.pictures, self.manifest)

    @property
    def not_indexed(self) -> int:
        """Number of the map's photos missing from the index in their current form (new, renamed, blurred)."""
        record = self.manifest.record_of
        return len({experience_of(e.id) for e in self.pictures if record(e.id, picture_name(e)) is None})

    @property
    def map_hash(self) -> str:
        """Hash of the map's photos and positions, 16 hexadecimal characters."""
        pairs = zip(self.pictures, self.contents, strict=True)
        photos = [[e.id, c, *e.position, *([e.floor] if e.floor else [])] for e, c in pairs]
        return hashlib.sha256(json.dumps(photos).encode()).hexdigest()[:16]


def contents_of(pictures: Sequence[Experience], manifest: Manifest) -> list[str]:
    """Look up the content hash of each picture; empty if it is not in the index."""
    return [r.content if (r := manifest.record_of(e.id, picture_name(e))) else "" for e in pictures]
