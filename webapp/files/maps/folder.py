"""A map and its files: the `.cfg`, the JSON next to it, further placements, and photos in its folder."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from webapp.core.boxes import BlurBox
from webapp.core.geo.types import MapPixel, inside, whole_pixel
from webapp.core.mapmodel.model import Experience, Map, Placement, UnplacedPhoto, facts_of
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import MapError
from webapp.files.atomic import write_bytes
from webapp.files.contents import hash_of, local
from webapp.files.maps.cfg import format_cfg, parse_cfg, read_bytes, read_cfg
from webapp.files.maps.lists import LISTS
from webapp.files.maps.map_json import MapJson, MapJsonPhoto, format_map_json, parse_map_json
from webapp.files.part_file import sha256_of


def json_path(cfg_path: Path) -> Path:
    """Return the JSON path of a `.cfg`: `map.json` for `map.cfg`, `NAME.map.json` for any `NAME.cfg`."""
    return cfg_path.with_name("map.json" if cfg_path.stem == "map" else f"{cfg_path.stem}.map.json")


def placement_path(cfg_path: Path, name: str) -> Path:
    """Return the path of the `.cfg` of a further placement, next to the map's own."""
    return cfg_path.with_name(f"{name}.cfg")


class MapFolder:
    """Finds the files that a `.cfg` names, only below its folder; each folder is resolved once."""

    def __init__(self, cfg_path: Path) -> None:
        self._cfg_path = cfg_path
        self._stays: dict[Path, bool] = {}

    def path(self, name: str) -> Path:
        """Return the path of a photo or the satellite image, which need not exist; an object is fetched."""
        return local(self.place(name))

    def place(self, name: str) -> Path:
        """Return the path of a photo or the satellite image in the map's folder; it need not exist.

        MapError if the name, or a symbolic link in its path, leads out of the folder.
        """
        problem = name_problem(name)
        if problem:
            raise self._error(problem.message, hint="keep photos below the map's folder")
        path = self._cfg_path.parent / name
        try:
            if path.parent not in self._stays:
                self._stays[path.parent] = self._is_inside(path.parent)
            stays = self._stays[path.parent] and (not path.is_symlink() or self._is_inside(path))
        except (OSError, RuntimeError) as error:  # a loop of links
            raise self._error(f"{name!r} is a broken link: {error}", hint="replace the link") from error
        if not stays:
            message = f"{name!r} is a link that points outside the map's folder"
            raise self._error(message, hint="replace the link with a copy of the file")
        return path

    def _is_inside(self, path: Path) -> bool:
        return path.resolve().is_relative_to(self._cfg_path.parent.resolve())

    def _error(self, message: str, *, hint: str) -> MapError:
        return MapError(message, where=str(self._cfg_path), hint=hint)


def photo_path(cfg_path: Path, name: str) -> Path:
    """Return the path of a photo or the satellite image of a map; see `MapFolder.path`."""
    return MapFolder(cfg_path).path(name)


def photo_hash(cfg_path: Path, name: str) -> str:
    """Return the SHA-256 of a photo of a map, without fetching it if it is an object."""
    return hash_of(MapFolder(cfg_path).place(name))


def read_map_json(cfg_path: Path) -> MapJson:
    """Read the JSON next to a `.cfg`; if there is none, return an empty `MapJson`."""
    path = json_path(cfg_path)
    return parse_map_json(read_bytes(path), where=str(path)) if path.exists() else MapJson()


def read_map(cfg_path: Path) -> Map:
    """Read a map: the `.cfg`, and the files next to it.

    The `.cfg` is authoritative. Data in `map.json` on an id that is gone or now has another photo, and
    sub-pixel positions that do not round to the `.cfg`'s, are ignored (the `.cfg` was edited by other means;
    the linter reports it).

    Raises:
        MapError: `CfgError` and `MapJsonError` with the location in the file; or a placement is missing or
            has other photos.
    """
    base = read_cfg(cfg_path).map
    extras = read_map_json(cfg_path)
    experiences = tuple(_completed(e, extras.experiences.get(e.id), base) for e in base.experiences)
    unplaced = _unplaced(base, extras)
    photos = {e.id: e.photo for e in base.experiences}
    return replace(
        base,
        experiences=experiences,
        georeference=extras.georeference,
        placements=tuple(
            _read_placement(cfg_path, base, name=n, exact=p, photos=photos)
            for n, p in extras.placements.items()
        ),
        next_id=max([base.next_id, extras.next_id, *(photo.id + 1 for photo in unplaced)]),
        revision=extras.revision,
        title=extras.title,
        description=extras.description,
        unplaced=unplaced,
        **{name: getattr(extras, name) for name in LISTS},
    )


def write_map(cfg_path: Path, map_: Map, *, from_gps: Collection[int] = ()) -> None:
    """Write a map: placements, then the JSON, then the `.cfg`, each file atomically.

    After an interruption, the old `.cfg` stays authoritative for ids, photos and whole pixels. A map that
    a `.cfg` alone can hold gets no JSON, unless there is one already.

    Args:
        cfg_path: Its folder must exist.
        from_gps: Ids of photos that are moved away from their GPS positions. After an interruption, they
            count as placed by GPS wherever the `.cfg` has them, so that no position is taken for a more exact
            one.

    Raises:
        MapError: The files cannot hold something in the map; nothing was written.
        StorageError: Writing failed.
    """
    cfg, extras = format_cfg(map_), format_map_json(map_)
    placed = [(placement_path(cfg_path, p.name), format_cfg(placed_map(map_, p))) for p in map_.placements]
    names = [path.name.casefold() for path, _ in placed] + [cfg_path.name.casefold()]
    if len(set(names)) < len(names):
        raise MapError("two placements have one file name", where=str(cfg_path), hint="rename one of them")
    for path, content in placed:
        write_bytes(path, content)
    if json_path(cfg_path).exists() or parse_cfg(cfg).map != map_:
        before = format_map_json(map_, by_gps_anywhere=from_gps) if from_gps else extras
        write_bytes(json_path(cfg_path), before)
    write_bytes(cfg_path, cfg)
    if from_gps:
        write_bytes(json_path(cfg_path), extras)


def placed_map(map_: Map, placement: Placement) -> Map:
    """Return the map that a placement's own `.cfg` holds."""
    at = placement.positions
    unknown = sorted(set(at) - {e.id for e in map_.experiences})
    if unknown:
        raise MapError(f"the placement {placement.name} has the id {unknown[0]}, which the map does not have")
    return replace(
        map_,
        experiences=tuple(
            replace(e, position=at[e.id], by_gps=False, radius_px=None)
            for e in map_.experiences
            if e.id in at
        ),
    )


def _completed(e: Experience, known: MapJsonPhoto | None, map_: Map) -> Experience:
    if known is None or known.photo != e.photo:
        return e
    position = _exact(e.position, known.position, map_)
    is_as_known = known.position in (None, position)
    return replace(
        e,
        position=position,
        by_gps=known.by_gps and is_as_known,
        radius_px=known.radius_px if is_as_known else None,
        floor=known.floor,
        **facts_of(known),
    )


def _unplaced(base: Map, extras: MapJson) -> tuple[UnplacedPhoto, ...]:
    """List the photos in the tray, except ids and photos that are in the `.cfg`."""
    ids, photos = {e.id for e in base.experiences}, {e.photo for e in base.experiences}
    return tuple(
        known for id, known in sorted(extras.unplaced.items()) if id not in ids and known.photo not in photos
    )


def _exact(whole: MapPixel, exact: MapPixel | None, map_: Map) -> MapPixel:
    """Return the sub-pixel position if it rounds to the `.cfg`'s and is inside the image, else the latter."""
    image = map_.satellite
    fits = exact is not None and inside(exact, width=image.width, height=image.height)
    return exact if exact is not None and fits and whole_pixel(exact) == whole else whole


def _read_placement(
    cfg_path: Path, map_: Map, *, name: str, exact: Mapping[int, MapPixel], photos: Mapping[int, str]
) -> Placement:
    path = placement_path(cfg_path, name)
    placed = read_cfg(path).map
    if placed.satellite != map_.satellite:
        hint = f"its first line must be that of {cfg_path.name}"
        raise MapError("the placement has a different satellite image", where=str(path), hint=hint)
    positions = {}
    for e in placed.experiences:
        if photos.get(e.id, e.photo) != e.photo:
            hint = f"the same id must have the same photo as in {cfg_path.name}: {photos[e.id]!r}"
            raise MapError(
                f"the experience {e.id} has a different photo, {e.photo!r}", where=str(path), hint=hint
            )
        if e.id in photos:
            positions[e.id] = _exact(e.position, exact.get(e.id), map_)
    return Placement(name, positions)


def boxes_in_file(folder: Path, the_map: Map, *, file: Path) -> tuple[BlurBox, ...]:
    everyone: list[Experience | UnplacedPhoto] = [*the_map.experiences, *the_map.unplaced]
    photos = [one for one in everyone if one.blurred]
    if not photos:
        return ()
    sha256 = sha256_of(file)
    same = (one for one in photos if _hash(folder / one.photo) == sha256)
    return tuple(dict.fromkeys(box for one in same for box in one.blurred))


def _hash(path: Path) -> str | None:
    try:
        return hash_of(path)
    except OSError:  # missing
        return None
