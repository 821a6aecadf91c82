"""The map file: a line for the satellite image, then one per photo with its position (`maps/FORMAT.md`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from webapp.core.geo.types import MapPixel, inside, whole_pixel
from webapp.core.mapmodel.checks import MAX_NUMBER, check_lines
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import CfgError, MapError
from webapp.files.maps.cfg_scan import BOM, Scan, scan

MAX_BYTES = 100_000_000
"""Larger files are refused: they are not maps (a million photos need half of it)."""


@dataclass(frozen=True, slots=True)
class CfgDocument:
    """A parsed `.cfg`: the map, and its exact text."""

    map: Map  # Only what a `.cfg` holds; positions are whole pixels
    bom: bool  # Whether it begins with a byte order mark
    # `lines`, `ends`: Text of each line, first the image's and then one per photo, and its line end.
    lines: tuple[str, ...]
    ends: tuple[str, ...]
    tail: str  # Blank lines at the end


def parse_cfg(data: str | bytes, *, where: str | None = None) -> CfgDocument:
    """Parse a `.cfg` strictly.

    Args:
        data: The file's content; bytes are UTF-8.
        where: Name of the file, for errors.

    Raises:
        CfgError: The first fault, with line, column and a fix.
    """
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    result = scan(raw)
    findings = [*result.faults, *check_lines(result.image, result.photos)]
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        first = min(errors, key=lambda finding: (finding.line, finding.column))
        raise CfgError(first.message, line=first.line, column=first.column, where=where, hint=first.fix)
    return CfgDocument(_map(result), result.bom, tuple(result.lines), tuple(result.ends), result.tail)


def read_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise MapError("map file not found", where=str(path), hint="check the path") from error
    except OSError as error:
        message = f"the map file cannot be read: {error.strerror or error}"
        raise MapError(
            message, where=str(path), hint="name the map file itself, and make it readable"
        ) from error
    if len(data) > MAX_BYTES:
        raise MapError(
            f"the file is larger than {MAX_BYTES // 10**6} MB", where=str(path), hint="is it a map file?"
        )
    return data


def read_cfg(path: Path) -> CfgDocument:
    """Read a `.cfg` file strictly; without the files next to it (see `folder.read_map`)."""
    return parse_cfg(read_bytes(path), where=str(path))


def format_cfg(map_: Map, *, like: CfgDocument | None = None) -> bytes:
    """Write the map as a `.cfg`.

    Args:
        map_: Positions are rounded half up to whole pixels.
        like: Its lines whose values have not changed, its byte order mark, line ends and trailing blank lines
            are kept: an unchanged document gives identical bytes. Without it the form is canonical: no byte
            order mark, LF after every line, no spaces around columns.

    Raises:
        MapError: A name or number that a `.cfg` cannot hold, a position outside the image, or a duplicate id.
    """
    _check_writable(map_)
    lines = [_line(*values) for values in _values(map_)]
    if like is None:
        return "".join(f"{line}\n" for line in lines).encode("utf-8")
    written = {_line(*values): i for i, values in enumerate(_values(like.map))}
    known = [written.get(line) for line in lines]
    usual = like.ends[0] or "\n"
    text = [line if i is None else like.lines[i] for line, i in zip(lines, known, strict=True)]
    ends = [usual if i is None else like.ends[i] or usual for i in known]
    ends[-1] = like.ends[-1]
    body = "".join(line + end for line, end in zip(text, ends, strict=True)) + like.tail
    return (BOM if like.bom else b"") + body.encode("utf-8")


def _map(result: Scan) -> Map:
    image = result.image
    assert (
        image is not None and image.image is not None and image.width is not None and image.height is not None
    )
    experiences = []
    for line in result.photos:
        assert line.id is not None and line.photo is not None and line.x is not None and line.y is not None
        experiences.append(Experience(line.id, line.photo, MapPixel(float(line.x), float(line.y))))
    next_id = max((e.id for e in experiences), default=-1) + 1
    return Map(SatelliteImage(image.image, image.width, image.height), tuple(experiences), next_id=next_id)


def _values(map_: Map) -> list[tuple[str | int, ...]]:
    image = map_.satellite
    photos = [(e.id, e.photo, *whole_pixel(e.position)) for e in map_.experiences]
    return [(image.path, image.width, image.height), *photos]


def _line(*values: str | int) -> str:
    return ";".join(str(value) for value in values)


def _check_writable(map_: Map) -> None:
    """Refuse a map that the strict reader would reject."""
    image = map_.satellite
    for name in (image.path, *(e.photo for e in map_.experiences)):
        problem = name_problem(name)
        if problem:
            hint = f"rename it to {problem.better}" if problem.better else "rename the file"
            raise MapError(problem.message, where=name, hint=hint)
    if not (1 <= image.width <= MAX_NUMBER and 1 <= image.height <= MAX_NUMBER):
        message = f"an image of {image.width} x {image.height} pixels cannot be written"
        raise MapError(message, where=image.path, hint=f"width and height are from 1 to {MAX_NUMBER}")
    used: set[int] = set()
    for e in map_.experiences:
        if e.id in used:
            raise MapError(f"the id {e.id} is used twice", where=e.photo, hint="give each photo its own id")
        used.add(e.id)
        if not 0 <= e.id <= MAX_NUMBER:
            raise MapError(
                f"the id {e.id} cannot be written", where=e.photo, hint=f"ids are from 0 to {MAX_NUMBER}"
            )
        if not inside(e.position, width=image.width, height=image.height):
            message = f"the position ({e.position.x:g}, {e.position.y:g}) is outside the image"
            hint = f"x is from 0 to {image.width}, y from 0 to {image.height} pixels"
            raise MapError(message, where=e.photo, hint=hint)
