"""Where a new map's files go: names relative to its folder, and copies of what lies elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2

from webapp.core.geo.blank import BlankPlan, draw
from webapp.core.mapmodel.model import Map
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import StorageError, UsageError
from webapp.files.atomic import write_bytes
from webapp.files.maps.folder import write_map

_PHOTOS = "photos"


class NewMapFolder:
    """The folder that a map is written into.

    Parameters
    ----------
    cfg : Path
        The map to write.
    photos : Path
        Folder of the photos.
    copy : bool
        Whether to copy photos and image from outside the map's folder into it.
    """

    def __init__(self, cfg: Path, photos: Path, *, copy: bool) -> None:
        self._cfg = cfg
        self._base = cfg.parent.resolve()
        self._photos = photos
        self._copy = copy

    @property
    def plan_path(self) -> Path:
        """The blank plan: `plan.png` of `map.cfg`, `NAME.plan.png` of any other `NAME.cfg`."""
        return self._cfg.with_name("plan.png" if self._cfg.stem == "map" else f"{self._cfg.stem}.plan.png")

    def check(self, *, force: bool, satellite: Path | None) -> None:
        """Refuse what would overwrite something, or could not be written down.

        Raises
        ------
        UsageError
        """
        if self._cfg.suffix.lower() != ".cfg":
            raise UsageError("a map's name ends in .cfg", where=str(self._cfg), hint="write -o MAP.cfg")
        if not self._photos.is_dir():
            raise UsageError("there is no such folder", where=str(self._photos), hint="check its path")
        for path in (self._cfg, self.plan_path) if satellite is None else (self._cfg,):
            if path.exists() and not force:
                raise UsageError("it already exists", where=str(path), hint="--force replaces it")
        if not self._copy and not self._photos.resolve().is_relative_to(self._base):
            hint = "write the map into the photos' folder or one above it, or add --copy to copy the photos"
            raise UsageError("the photos lie outside the map's folder", where=str(self._photos), hint=hint)
        self.image_name(satellite)

    def same(self, path: Path, others: Iterable[Path]) -> bool:
        """Return whether `path` is one of the others."""
        # os.path.realpath, unlike Path.resolve, also answers for links in a circle
        return any(os.path.realpath(path) == os.path.realpath(other) for other in others)

    def photo_name(self, name: str) -> str:
        """Name a photo of the photos' folder as the map does: relative to the map's folder."""
        folder = self._photos.resolve()
        if folder.is_relative_to(self._base):
            return (folder / name).relative_to(self._base).as_posix()
        return f"{_PHOTOS}/{name}"

    def image_name(self, satellite: Path | None) -> str:
        """Name the satellite image, or the blank plan, as the map does.

        Raises
        ------
        UsageError
            The image lies outside the map's folder and is not to be copied, or a map cannot hold its name.
        """
        if satellite is None:
            return self.plan_path.name
        parent = satellite.parent.resolve()
        if parent.is_relative_to(self._base):
            name = (parent / satellite.name).relative_to(self._base).as_posix()
        elif self._copy:
            name = satellite.name
        else:
            hint = "move it into the map's folder, or add --copy to copy it"
            raise UsageError(
                "the satellite image lies outside the map's folder", where=str(satellite), hint=hint
            )
        problem = name_problem(name)
        if problem:
            raise UsageError(problem.message, where=str(satellite), hint="rename the file")
        return name

    def write(
        self, map_: Map, *, originals: Mapping[str, str], satellite: Path | None, plan: BlankPlan | None
    ) -> None:
        """Write the map, last its `.cfg`.

        Parameters
        ----------
        originals : mapping of str to str
            Name of each photo in the map -> in the photos' folder.
        plan : BlankPlan or None
            The blank plan to draw.

        Raises
        ------
        StorageError, UsageError
            The disk refused, or a copy would replace another file.
        """
        try:
            self._base.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"the folder cannot be made: {error.strerror}"
            raise StorageError(message, where=str(self._base), hint="choose another folder") from error
        for name, original in originals.items():
            self._bring(self._photos / original, name)
        if satellite is not None:
            self._bring(satellite, map_.satellite.path)
        if plan is not None:
            write_bytes(self.plan_path, cv2.imencode(".png", draw(plan))[1].tobytes())
        write_map(self._cfg, map_)

    def _bring(self, source: Path, name: str) -> None:
        target = self._base / name
        if self.same(source, [target]):
            return
        try:
            data = source.read_bytes()
            if target.exists() and target.read_bytes() != data:
                raise UsageError("another file has this name", where=str(target), hint="remove or rename it")
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"it cannot be copied: {error.strerror}"
            raise StorageError(message, where=str(source), hint="check its permissions") from error
        write_bytes(target, data)
