"""Files beside photos that say where these were taken: `.xmp` of photo programs, JSON of Google Takeout."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from webapp.errors import MapJsonError
from webapp.files.decode import PHOTO_SUFFIXES
from webapp.files.json_fields import parse_json
from webapp.files.listing import DERIVED, list_files
from webapp.files.photos.exif import Gps, NoGps, agree, number, read_gps
from webapp.files.photos.photo import PhotoFacts
from webapp.files.photos.xmp import MAX_BYTES, locate, parse_xmp

SUFFIXES = frozenset({".xmp", ".json"})
"""Suffixes of these files, in lower case."""

_METADATA = ".supplemental-metadata"
"""What Google puts between the photo's name and `.json`, often cut off."""

_CUT_AT = 40
"""Characters from which on a name in Google's export may have been cut off; the limit is 46."""

_NUMBER = re.compile(r"(.*?)(\(\d{1,5}\))?")
_EDITS = (
    "edited", "effects", "smile", "mix", "bearbeitet", "modifié", "modifie", "editado", "editada",
    "ha editado", "upraveno", "upravené", "modificato", "bewerkt", "edytowane", "editat",
)  # fmt: skip
"""What Google adds to the names of edited photos, which have no JSON of their own."""

_LEAST_OF_EDIT = 2
"""Letters that are left of it in a long name that was cut off."""

_MOST_VALUES = 5000


def is_sidecar(name: str) -> bool:
    """Return whether a file may be one of these, by its suffix."""
    return PurePosixPath(name).suffix.lower() in SUFFIXES


class Sidecars:
    """Files beside photos.

    Args:
        names: Paths with forward slashes of all files; others are ignored.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._of_photo: dict[str, list[str]] = {}
        listed = list(names)
        photos = [name for name in listed if PurePosixPath(name).suffix.lower() in PHOTO_SUFFIXES]
        by_folder: dict[str, list[str]] = {}
        for name in listed:
            if is_sidecar(name):
                by_folder.setdefault(str(PurePosixPath(name).parent), []).append(name)
        folders = {folder: _Folder(there) for folder, there in by_folder.items()}
        for photo in photos:
            folder = folders.get(str(PurePosixPath(photo).parent))
            found = [] if folder is None else folder.choose(photo)
            if found:
                self._of_photo[photo] = found
        self._photo_of = {beside: photo for photo, found in self._of_photo.items() for beside in found}

    def of(self, photo: str) -> Sequence[str]:
        """Return the files beside a photo, in the order in which they count."""
        return self._of_photo.get(photo, ())

    def photo_of(self, name: str) -> str | None:
        return self._photo_of.get(name)


def sidecars_in(folder: Path, *, but: Path | None = None) -> Sidecars:
    """Find the sidecars in the folder of a map; not the file `but`, nor in hidden folders or `derived`."""
    files = list_files(folder, leave_out=[folder / DERIVED])
    return Sidecars(name for name in files if but is None or folder / name != but)


def choose(photo: str, names: Iterable[str]) -> list[str]:
    """Return those of some files that belong to a photo, in the order in which they count: first `.xmp`."""
    return _Folder(names).choose(photo)


class _Folder:
    """The files of a folder by their names, so that each photo costs a few look-ups."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names = {_plain(name): name for name in names}
        jsons = (plain.removesuffix(".json") for plain in self._names if plain.endswith(".json"))
        self._jsons = {base: place for place, base in enumerate(jsons)}
        self._lengths = {len(base) for base in self._jsons}

    def choose(self, photo: str) -> list[str]:
        last = _plain(photo)
        stem, _, suffix = last.rpartition(".")
        found = [self._names[name] for name in (f"{last}.xmp", f"{stem}.xmp") if name in self._names][:1]
        google = self._google(last)
        original = _original(stem)
        if google is None and original is not None:
            google = self._google(f"{original}.{suffix}")
        return [*found, *([google] if google else [])]

    def _google(self, photo: str) -> str | None:
        """Return the first JSON that is that of a photo in an export of Google Photos.

        For `a.jpg` it is `a.jpg`, `a.jpg.supplemental-metadata`, cut off anywhere, or `a`. The number of
        `a(1).jpg` stays, or is at the end: `a.jpg(1)`, `a.jpg.supplemental-metadata(1)`. Long names are
        cut off.
        """
        stem, _, suffix = photo.rpartition(".")
        plain_stem, number = _numbered(stem)
        bases = {photo, stem}
        for whole, count in {(f"{plain_stem}.{suffix}", number), (photo, "")}:
            longest, least = f"{whole}{_METADATA}", min(len(whole), _CUT_AT)
            for length in self._lengths:
                written = longest[: max(length - len(count), 0)]
                if len(written) >= least and _numbered(f"{written}{count}") == (written, count):
                    bases.add(f"{written}{count}")
        found = bases & self._jsons.keys()
        return self._names[f"{min(found, key=self._jsons.__getitem__)}.json"] if found else None


def _plain(name: str) -> str:
    return unicodedata.normalize("NFC", PurePosixPath(name).name).lower()


def _original(stem: str) -> str | None:
    """Return the name of the photo that an edited one was made of, both without suffix; None for others."""
    plain, count = _numbered(stem)
    head, dash, edit = plain.rpartition("-")
    was_cut = len(stem) >= _CUT_AT and len(edit) >= _LEAST_OF_EDIT
    known = edit in _EDITS or (was_cut and any(one.startswith(edit) for one in _EDITS))
    return f"{head}{count}" if dash and known else None


def _numbered(name: str) -> tuple[str, str]:
    found = _NUMBER.fullmatch(name)
    return (name, "") if found is None else (found[1], found[2] or "")


@dataclass(frozen=True, slots=True)
class Sidecar:
    """A file beside a photo."""

    name: str
    data: bytes | None  # None if it cannot be read


def beside_photo(photo: str, files: Iterable[Sidecar]) -> list[Sidecar]:
    """Return those of some files that belong to a photo, in the order in which they count."""
    by_name = {one.name: one for one in files}
    return [by_name[name] for name in choose(photo, by_name)]


def read_sidecars(paths: Iterable[Path]) -> list[Sidecar]:
    """Read files beside a photo, each up to the limit; links are not followed."""
    return [Sidecar(path.name, None if path.is_symlink() else _content(path)) for path in paths]


def _content(path: Path) -> bytes | None:
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError:  # it is noted
        return None


def with_sidecars(facts: PhotoFacts, found: Iterable[Sidecar]) -> PhotoFacts:
    """Complete the facts of a photo from its sidecar files.

    The position of an `.xmp` counts more than that in the photo, as people correct it there; that of Google's
    JSON counts only without another one.
    """
    for one in found:
        if one.data is None:
            facts = _noted(facts, f"{one.name} cannot be read and was left out")
        elif len(one.data) > MAX_BYTES:
            facts = _noted(facts, f"{one.name} is too large for a file about a photo and was left out")
        elif one.name.lower().endswith(".xmp"):
            facts = _with_xmp(facts, one.name, one.data)
        else:
            facts = _with_google(facts, one.name, one.data)
    return facts


def _noted(facts: PhotoFacts, note: str) -> PhotoFacts:
    return replace(facts, notes=(*facts.notes, note))


def _with_xmp(facts: PhotoFacts, name: str, data: bytes) -> PhotoFacts:
    xmp = parse_xmp(data)
    if xmp.note is not None:
        return _noted(facts, f"{name} is damaged and was left out")
    there = locate({}, xmp)
    if isinstance(there.gps, Gps):
        facts = replace(facts, gps=_corrected(facts.gps, replace(there.gps, source=name)))
    pitch = facts.pitch_deg if there.pitch_deg is None else there.pitch_deg
    return replace(facts, heading=there.heading or facts.heading, pitch_deg=pitch)


def _corrected(gps: Gps | NoGps, beside: Gps) -> Gps | NoGps:
    """Return the position beside a photo, or the photo's own, which says more, if that is only repeated."""
    if isinstance(gps, NoGps):
        return gps if gps.refuses(beside) else beside
    if not agree(gps, beside):
        return beside
    return replace(
        gps,
        accuracy_m=beside.accuracy_m if gps.accuracy_m is None else gps.accuracy_m,
        dop=beside.dop if gps.dop is None else gps.dop,
        altitude_m=beside.altitude_m if gps.altitude_m is None else gps.altitude_m,
    )


def _with_google(facts: PhotoFacts, name: str, data: bytes) -> PhotoFacts:
    try:
        content = parse_json(data, where=name, most_values=_MOST_VALUES).value
    except MapJsonError:
        return _noted(facts, f"{name} is damaged and was left out")
    if not isinstance(content, dict):
        return facts
    if not isinstance(facts.gps, Gps):
        for key in ("geoData", "geoDataExif"):
            found = read_gps(_google_tags(content.get(key)))
            if isinstance(found, Gps) and not facts.gps.refuses(found):
                facts = replace(facts, gps=replace(found, source=name))
                break
    taken = content.get("photoTakenTime")
    return replace(facts, taken_at=facts.taken_at or _google_time(taken if isinstance(taken, dict) else {}))


def _google_tags(place: object) -> dict[int, object]:
    """Return a position of Google as tags of the GPS IFD; 0, 0 means none."""
    known: Mapping[str, Any] = place if isinstance(place, dict) else {}
    lat, lon, height = (number(known.get(key)) for key in ("latitude", "longitude", "altitude"))
    if lat is None or lon is None or (lat, lon) == (0.0, 0.0):
        return {}
    tags: dict[int, object] = {
        1: "S" if lat < 0 else "N",
        2: abs(lat),
        3: "W" if lon < 0 else "E",
        4: abs(lon),
    }
    return tags | ({6: height} if height else {})


def _google_time(taken: Mapping[str, object]) -> str | None:
    stamp = str(taken.get("timestamp", ""))
    if not re.fullmatch(r"-?\d{1,11}", stamp):
        return None
    try:
        return datetime.fromtimestamp(int(stamp), UTC).isoformat()
    except (OverflowError, ValueError, OSError):
        return None
