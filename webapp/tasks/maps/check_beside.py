"""What is wrong with the files beside a `.cfg`: `map.json` and further placements."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from webapp.core.geo.georeference import Georeference
from webapp.core.mapmodel.checks import check_lines, free_id
from webapp.core.mapmodel.findings import Code, Finding, quoted
from webapp.core.mapmodel.lines import PhotoLine
from webapp.core.mapmodel.positions import whole_pixel
from webapp.errors import MapError
from webapp.files.maps.cfg import read_bytes
from webapp.files.maps.cfg_scan import Scan, scan
from webapp.files.maps.folder import json_path, placement_path, read_map_json
from webapp.files.maps.map_json import MapJson


@dataclass(frozen=True, slots=True)
class Beside:
    """Findings about the files beside a `.cfg`, and the georeference that `map.json` gives."""

    findings: list[Finding] = field(default_factory=list)
    georeference: Georeference | None = None


def check_beside(cfg_path: Path, pieces: Scan) -> Beside:
    """Check `map.json` and the placements it names against the lines of the `.cfg`.

    Parameters
    ----------
    cfg_path : Path
    pieces : Scan

    Returns
    -------
    Beside
        Empty where there is no `map.json`.
    """
    file = json_path(cfg_path).name
    try:
        known = read_map_json(cfg_path)
    except MapError as error:
        fix = error.hint or "restore the file, or delete it: the .cfg alone is a map"
        message = f"{error.where}: {error.message}" if error.where else error.message
        return Beside([Finding(Code.MAP_JSON_DAMAGED, 1, 1, message, fix, file)])
    lines = {line.id: line for line in pieces.photos if line.id is not None}
    findings = [*_stale(known, lines, file=file), *_positions(known, lines, file=file)]
    if json_path(cfg_path).exists() and known.next_id < free_id(pieces.photos):
        message = f"next_id is {known.next_id}, but the map has the id {free_id(pieces.photos) - 1}"
        fix = f"write next_id {free_id(pieces.photos)}"
        findings.append(Finding(Code.NEXT_ID_TOO_SMALL, 1, 1, message, fix, file))
    for name in known.placements:
        findings += _placement(cfg_path, name, pieces=pieces)
    return Beside(findings, known.georeference)


def _stale(known: MapJson, lines: dict[int, PhotoLine], *, file: str) -> Iterator[Finding]:
    """Find records of photos that the `.cfg` no longer has."""
    for id, record in known.experiences.items():
        line = lines.get(id)
        if line is None:
            message = f"the id {id} ({quoted(record.photo)}) is not in the .cfg: its record does not count"
            yield Finding(Code.MAP_JSON_STALE, 1, 1, message, f"delete the record of id {id}", file)
        elif line.photo is not None and line.photo != record.photo:
            message = f"the id {id} is {quoted(line.photo)} in the .cfg, but {quoted(record.photo)} in {file}"
            fix = f"write the same photo in both; until then the record in {file} does not count"
            yield Finding(Code.MAP_JSON_STALE, line.line, line.columns[1], message, fix)


def _positions(known: MapJson, lines: dict[int, PhotoLine], *, file: str) -> Iterator[Finding]:
    """Find sub-pixel positions that do not round to those of the `.cfg`."""
    for id, record in known.experiences.items():
        line = lines.get(id)
        if line is None or line.photo != record.photo or record.position is None:
            continue
        at, exact = (line.line, line.columns[2]), record.position
        x, y = whole_pixel(exact)
        if None in (line.x, line.y) or (line.x, line.y) == (x, y):
            continue
        if (line.y, line.x) == (x, y):
            message = f"x and y seem to be swapped: {file} has ({exact.x:g}, {exact.y:g})"
            yield Finding(Code.SWAPPED_XY, *at, message, f"write {line.text(x=x, y=y)}")
        else:
            message = f"{file} has ({exact.x:g}, {exact.y:g}), which is not this position; this line counts"
            fix = f"write {line.text(x=x, y=y)}, or delete x_px and y_px of id {id} in {file}"
            yield Finding(Code.MAP_JSON_POSITION, *at, message, fix)


def _placement(cfg_path: Path, name: str, *, pieces: Scan) -> list[Finding]:
    """Check the `.cfg` of a placement by itself and against the map's."""
    path = placement_path(cfg_path, name)
    try:
        placed = scan(read_bytes(path))
    except MapError as error:
        fix = f"put {path.name} back, or delete the placement {name!r} in {json_path(cfg_path).name}"
        return [Finding(Code.PLACEMENT_DAMAGED, 1, 1, error.message, fix, path.name)]
    found = [*placed.faults, *check_lines(placed.image, placed.photos)]
    found = [replace(finding, file=path.name) for finding in found]
    if placed.image and pieces.image and _image(placed) != _image(pieces):
        message = f"the first line is not that of {cfg_path.name}"
        fix = "write {};{};{}".format(*_image(pieces))
        found.append(Finding(Code.PLACEMENT_DAMAGED, 1, 1, message, fix, path.name))
    photos = {line.id: line.photo for line in pieces.photos if line.id is not None}
    for line in placed.photos:
        if line.id is not None and line.id not in photos:
            message = f"the id {line.id} is not in {cfg_path.name}: the line does not count"
            found.append(Finding(Code.PLACEMENT_STALE, line.line, 1, message, "delete the line", path.name))
        elif (
            line.id is not None
            and None not in (line.photo, photos[line.id])
            and line.photo != photos[line.id]
        ):
            message = (
                f"the id {line.id} has another photo in {cfg_path.name}: {quoted(photos[line.id] or '')}"
            )
            fix = f"write {line.id};{photos[line.id]};{line.x};{line.y}"
            found.append(Finding(Code.PLACEMENT_DAMAGED, line.line, line.columns[1], message, fix, path.name))
    return found


def _image(pieces: Scan) -> tuple[object, ...]:
    image = pieces.image
    return (image.image, image.width, image.height) if image else ()
