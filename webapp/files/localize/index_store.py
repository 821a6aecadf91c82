"""The index of a map on disk: a manifest, and immutable segments that it names.

::

    derived/map/sift-1a2b3c4d/
        manifest.json               replaced by rename; names everything below
        <codebook>.codebook         trained, empty search index, or the codebook of the signatures
        <segment>.features          keypoints and descriptors of some photos
        <segment>-<codebook>.ivf    the same descriptors as codes of the codebook; or, in large maps:
        <segment>-<codebook>.vlad   a signature of each photo
        spool/<content>.features    photos that an unfinished build has finished
        lock                        one writer at a time

The names are hashes of the contents, so that equal photos and settings give equal names.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, get_args

import faiss

from webapp.core.features.table import FeatureChoice
from webapp.core.features.types import Engine, Kind
from webapp.errors import IndexDamaged, StorageError
from webapp.files import atomic, contents
from webapp.files.localize.arrays import REPAIR, present
from webapp.files.sealed import sealed, unsealed
from webapp.settings import ExtractSettings

FORMAT = 2
"""To be increased when older indexes can no longer be read, or their descriptors differ from new ones."""


_BLOCKS = b"IwPf"
"""First bytes of Faiss's file of an inverted index (IVF) with 4-bit codes."""


@dataclass(frozen=True, slots=True)
class PhotoRecord:
    photo: str  # Path as in the map
    # `bytes`, `mtime_ns`: Size and modification time of the file: the same values mean the same content.
    bytes: int
    mtime_ns: int
    content: str  # SHA-256 of the file; empty if it could not be read
    error: str = ""  # Why it has no features; empty if it has


@dataclass(frozen=True, slots=True)
class SegmentRecord:
    """A segment: the hash that names it, and its size."""

    name: str
    photos: int
    descriptors: int
    codes: str
    """SHA-256 of its codes, first 16 characters."""


@dataclass(frozen=True, slots=True)
class Manifest:
    detector: str
    extractor: str
    extract: ExtractSettings
    codebook: str = ""  # Name of the codebook; empty as long as there are no descriptors
    trained_for: int = 0  # Number of descriptors in the index when the codebook was trained
    segments: tuple[SegmentRecord, ...] = ()
    photos: dict[int, PhotoRecord] = field(default_factory=dict)  # By experience id
    build_seconds: float = 0.0  # Total time of all builds that changed it
    engine: Engine = "ivf"  # "ivf" or "vlad". Kind of the codebook and the codes.

    def record_of(self, id: int, picture: str) -> PhotoRecord | None:
        """Return the record of an experience if it refers to the picture of that name."""
        record = self.photos.get(id)
        return record if record is not None and record.photo == picture else None


_OURS = frozenset({".features", ".ivf", ".vlad", ".codebook", ".tmp"})


class IndexFolder:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.spool = folder / "spool"
        self.manifest_path = folder / "manifest.json"

    def segment_path(self, name: str) -> Path:
        return self.folder / f"{name}.features"

    def codes_path(self, name: str, *, codebook: str, engine: Engine) -> Path:
        return self.folder / f"{name}-{codebook}.{engine}"

    def codebook_path(self, name: str) -> Path:
        return self.folder / f"{name}.codebook"

    def spool_path(self, content: str) -> Path:
        return self.spool / f"{content}.features"

    def remove_unfinished(self) -> None:
        """Remove temporary files of killed writers from the spool; the caller must hold the writers' lock."""
        for path in self.spool.glob(".*.tmp"):
            path.unlink(missing_ok=True)

    def make_spool(self) -> None:
        """Create the folder for finished photos; that of the index must exist. Raises StorageError."""
        try:
            self.spool.mkdir(exist_ok=True)
        except OSError as error:
            raise StorageError(
                f"the folder cannot be created: {error.strerror}", where=str(self.spool)
            ) from error

    def read_manifest(self) -> Manifest | None:
        """Read the manifest; None if there is no index yet. Raises IndexDamaged."""
        try:
            raw = unsealed(self.manifest_path.read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._damaged(f"cannot be read: {error.strerror or error}") from error
        except ValueError as error:
            raise self._damaged("is damaged") from error
        try:
            if raw["format"] != FORMAT:
                raise self._damaged(f"has format {raw['format']}, this program reads format {FORMAT}")
            engine = raw.get("engine", "ivf")  # older programs did not write it
            if engine not in get_args(Engine):
                raise self._damaged(f"names the engine {engine!r}, which this program does not know")
            return Manifest(
                engine=engine,
                detector=raw["detector"],
                extractor=raw["extractor"],
                extract=ExtractSettings(**raw["extract"]),
                codebook=raw["codebook"],
                trained_for=raw["trained_for"],
                segments=tuple(SegmentRecord(**s) for s in raw["segments"]),
                photos={int(i): PhotoRecord(**p) for i, p in raw["photos"].items()},
                build_seconds=raw["build_seconds"],
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise self._damaged("has missing or invalid fields") from error

    def _damaged(self, what: str) -> IndexDamaged:
        return IndexDamaged(f"the manifest {what}", where=str(self.manifest_path), hint=REPAIR)

    def write_manifest(self, manifest: Manifest) -> None:
        atomic.write_bytes(self.manifest_path, sealed({"format": FORMAT, **asdict(manifest)}))

    def remove_unnamed(self, manifest: Manifest) -> None:
        """Delete finished photos and files that the manifest does not name. Raises StorageError."""
        keep = self._named(manifest)
        try:
            for path in [*self.folder.iterdir(), *self.spool.iterdir()]:
                named = path.with_name(contents.shown_name(path.name))
                if named.suffix in _OURS and named not in keep:
                    with suppress(PermissionError):  # open in a reader, on Windows: left for the next time
                        path.unlink(missing_ok=True)
        except OSError as error:
            raise StorageError(
                f"the folder cannot be cleaned up: {error.strerror}", where=str(self.folder)
            ) from error

    def _named(self, manifest: Manifest) -> set[Path]:
        named = {self.codebook_path(manifest.codebook)}
        for segment in manifest.segments:
            codes = self.codes_path(segment.name, codebook=manifest.codebook, engine=manifest.engine)
            named |= {self.segment_path(segment.name), codes}
        return named

    def publish(self, manifest: Manifest) -> None:
        """Turn the files that a manifest names into objects, before it is written; see `contents.settle`.

        Raises StorageError.
        """
        for path in sorted(self._named(manifest)):
            contents.settle(path)

    def fetch(self, manifest: Manifest) -> None:
        """Fetch segments and codes that are objects in parallel; reading would fetch them one by one.

        Raises StorageError.
        """
        contents.fetch_together(sorted(self._named(manifest) - {self.codebook_path(manifest.codebook)}))

    def bytes_on_disk(self) -> int:
        """Sum the sizes of all files of the index, skipping those that a build removes meanwhile."""
        total = 0
        for path in self.folder.rglob("*"):
            with suppress(FileNotFoundError):
                shown = path.with_name(contents.shown_name(path.name))
                pointer = contents.pointer_of(shown) if shown != path else None
                total += pointer.bytes if pointer else path.stat().st_size if path.is_file() else 0
        return total


def index_key(choice: FeatureChoice, extract: ExtractSettings) -> str:
    """Return the folder name of the index with these features and settings."""
    own = [choice.weights] if choice.weights else []
    parts = json.dumps([FORMAT, choice.detector, choice.extractor, asdict(extract), *own], sort_keys=True)
    name = choice.name.replace("+", "-")
    return f"{name}-{hashlib.sha256(parts.encode()).hexdigest()[:8]}"


def remove_outdated(base: Path) -> None:
    """Delete indexes below a folder whose older format can no longer be read."""
    for path in base.glob("*/manifest.json"):
        try:
            form = unsealed(path.read_bytes())["format"]
        except (ValueError, KeyError, TypeError, FileNotFoundError):
            continue  # damaged, but maybe of the current format: the next build with its features repairs it
        if isinstance(form, int) and form < FORMAT:
            shutil.rmtree(path.parent, ignore_errors=True)  # leftovers are deleted by the next build


def write_search_index(path: Path, index: Any, *, kind: Kind) -> str:
    """Write a Faiss index atomically; `{hash}` in the name becomes its hash, which is returned."""
    data = (
        faiss.serialize_index_binary(index) if kind == "binary" else faiss.serialize_index(index)
    ).tobytes()
    digest = hashlib.sha256(data).hexdigest()[:16]
    target = path.with_name(path.name.replace("{hash}", digest))
    atomic.write_bytes(target, data)
    contents.replaced(target)
    return digest


def read_search_index(path: Path, kind: Kind, *, mapped: bool = True, digest: str = "") -> Any:
    """Open a Faiss index; memory-mapped (`mapped`) unless it will be modified.

    With `digest`, as returned by `write_search_index`, its content is compared, which reads all of it.

    Raises:
        StorageError: The file is an object, and the storage or the disk of the cache failed.
    """
    path = present(path)
    try:
        if digest and _digest(path) != digest:
            raise IndexDamaged("it differs from its checksum", where=str(path), hint=REPAIR)
        if kind == "binary":
            return faiss.read_index_binary(os.fspath(path), faiss.IO_FLAG_MMAP if mapped else 0)
        in_place = mapped and not _is_copied(path)
        return faiss.read_index(os.fspath(path), faiss.IO_FLAG_MMAP_IFC if in_place else 0)
    except (OSError, RuntimeError, MemoryError) as error:
        raise IndexDamaged(
            "it is not a search index, or it is truncated", where=str(path), hint=REPAIR
        ) from error


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def _is_copied(path: Path) -> bool:
    """Return whether Faiss copies the codes anyway, so that a memory map would hold them twice."""
    try:
        with path.open("rb") as file:
            return file.read(len(_BLOCKS)) == _BLOCKS
    except OSError:
        return False  # Faiss reports the error in more detail
