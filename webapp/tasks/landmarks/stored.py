"""Suggested places of the photos of a tray as JSON values, and the file with the latest ones of a map."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from webapp.core.geo.types import MapPixel
from webapp.errors import NotFound, StorageError
from webapp.files.atomic import make_folder, write_text
from webapp.files.landmarks.colmap import SUBMODELS_FILE, export_model, read_submodels
from webapp.files.listing import DERIVED
from webapp.tasks.landmarks.mapping import adjusted_folders, model_folders
from webapp.tasks.landmarks.place_rest import CorrectedPlace, RestReport, SuggestedPlace
from webapp.tasks.landmarks.reconstruct import Reconstruction

_FILE = "place-rest.json"
_VERSION = 2
_NOTHING: dict[str, Any] = {"photos": [], "checked": [], "place_next": [], "corrected": []}
_WAIT_S = 20.0


def as_json(report: RestReport, *, accepted: Collection[int] = ()) -> dict[str, Any]:
    """Convert suggestions to JSON values; `accepted` are ids of photos that have been placed there."""
    suggested = [_place_json(one, accepted=one.id in accepted) for one in report.suggested]
    left: list[dict[str, Any]] = [
        {"id": one.id, "photo": one.photo, "error": one.reason, "place_first": list(one.join)}
        for one in report.left
    ]
    checked = [
        {
            "id": one.id,
            "photo": one.photo,
            "residual_px": None if one.residual_px is None else round(one.residual_px, 2),
            "residual_m": None if one.residual_m is None else round(one.residual_m, 2),
            "x_px": None if one.predicted is None else round(one.predicted.x, 2),
            "y_px": None if one.predicted is None else round(one.predicted.y, 2),
            "bearing_deg": None if one.bearing_deg is None else round(one.bearing_deg, 1),
            "contradicts": one.contradicts,
        }
        for one in report.checked
    ]
    corrected = [
        {
            "id": one.id,
            "photo": one.photo,
            "x_px": round(one.position.x, 2),
            "y_px": round(one.position.y, 2),
            "from_x_px": round(one.before.x, 2),
            "from_y_px": round(one.before.y, 2),
            "moved_px": round(one.moved_px, 2),
            "moved_m": round(one.moved_m, 2),
            "radius_px": round(one.radius_px, 2),
            "heading_deg": None if one.heading_deg is None else round(one.heading_deg, 2),
        }
        for one in report.corrected
    ]
    return {
        "photos": [*suggested, *left],
        "checked": checked,
        "place_next": list(report.place_next),
        "corrected": corrected,
    }


def _place_json(one: SuggestedPlace, *, accepted: bool) -> dict[str, Any]:
    return {
        "id": one.id,
        "photo": one.photo,
        "x_px": round(one.position.x, 2),
        "y_px": round(one.position.y, 2),
        "radius_px": round(one.radius_px, 2),
        "heading_deg": None if one.heading_deg is None else round(one.heading_deg, 2),
        "placed_by": list(one.placed_by),
        "is_checked": one.is_checked,
        "accepted": accepted,
    }


def keep(cfg: Path, report: RestReport, *, revision: int) -> None:
    """Store suggestions for the page of the map. Raises StorageError."""
    content = {"version": _VERSION, "revision": revision, **as_json(report)}
    with _one_writer(cfg):
        found = {photo["id"] for photo in content["photos"] if "error" not in photo}
        planned = [p for p in _planned(cfg) if p["id"] not in found]
        known = {photo["id"] for photo in planned}
        content["photos"] = [*planned, *(p for p in content["photos"] if p["id"] not in known)]
        write_text(_path(cfg), json.dumps(content))


def suggest(cfg: Path, place: SuggestedPlace, *, revision: int) -> None:
    """Add the spot for which a photo was planned as a suggestion; `keep` retains it unless it finds a place.

    Raises StorageError.
    """
    one = {**_place_json(place, accepted=False), "planned": True, "revision": revision}
    with _one_writer(cfg):
        content = read(cfg) or {**_NOTHING, "version": _VERSION, "revision": revision}
        others = [photo for photo in content["photos"] if photo["id"] != place.id]
        write_text(_path(cfg), json.dumps({**content, "photos": [one, *others]}))


def _planned(cfg: Path) -> list[dict[str, Any]]:
    try:
        found = read(cfg) or _NOTHING
    except StorageError:
        return []  # damaged: `read` advises users to look for places again
    return [photo for photo in found["photos"] if photo.get("planned")]


@contextmanager
def _one_writer(cfg: Path) -> Iterator[None]:
    """Lock the suggestions of a map for writing."""
    make_folder(_path(cfg).parent)
    try:
        with FileLock(_path(cfg).with_suffix(".lock"), timeout=_WAIT_S):
            yield
    except Timeout as error:
        raise StorageError(
            "the suggested places are being changed", where=_FILE, hint="try again in a moment"
        ) from error


def read(cfg: Path) -> dict[str, Any] | None:
    """Read the stored suggestions: `revision` and the fields of `as_json`; None if there are none."""
    try:
        content: dict[str, Any] = json.loads(_path(cfg).read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StorageError(
            "the suggested places cannot be read", where=_FILE, hint="look for them again"
        ) from error
    return content if content.get("version") == _VERSION else None


def is_of_image(photo: Mapping[str, Any], satellite_revision: int) -> bool:
    """Return whether a suggestion is for the current image; only planned spots have their own revision."""
    return bool(photo.get("revision", satellite_revision) >= satellite_revision)


def suggested_of(cfg: Path, ids: Iterable[int], *, satellite_revision: int = 0) -> list[SuggestedPlace]:
    """Return the suggestions for some photos, except those for a replaced image."""
    records = [
        photo
        for photo in (read(cfg) or _NOTHING)["photos"]
        if "error" not in photo and is_of_image(photo, satellite_revision)
    ]
    return [
        SuggestedPlace(
            one["id"],
            one["photo"],
            MapPixel(one["x_px"], one["y_px"]),
            one["radius_px"],
            one["heading_deg"],
            tuple(one["placed_by"]),
            one.get("is_checked", True),
        )
        for one in _chosen(records, ids, missing="no place is suggested for this photo")
    ]


def corrected_of(cfg: Path, ids: Iterable[int]) -> list[CorrectedPlace]:
    records = (read(cfg) or {"corrected": []})["corrected"]
    return [
        CorrectedPlace(
            one["id"],
            one["photo"],
            MapPixel(one["x_px"], one["y_px"]),
            MapPixel(one["from_x_px"], one["from_y_px"]),
            one["moved_px"],
            one["moved_m"],
            one["radius_px"],
            one["heading_deg"],
        )
        for one in _chosen(records, ids, missing="no correction is suggested for this photo")
    ]


def _chosen(records: Iterable[dict[str, Any]], ids: Iterable[int], *, missing: str) -> list[dict[str, Any]]:
    known = {one["id"]: one for one in records}
    wanted = list(ids)
    for id in wanted:
        if id not in known:
            raise NotFound(missing, where=f"photo/{id}")
    return [known[id] for id in wanted]


def _path(cfg: Path) -> Path:
    return cfg.parent / DERIVED / _FILE


@dataclass(frozen=True, slots=True)
class ExportedModel:
    folder: Path
    photos: int
    points: int


def names_of_photos(found: Reconstruction) -> dict[str, str]:
    """Return the paths of the photos by the SHA-256 of their files; a view has its turn as suffix."""
    names = {content: found.photos[number].photo for content, number in found.number_of.items()}
    return names | {content: f"{names[content]}#{turn:03}" for content, turn in found.turn_of.items()}


def export_models(
    folder: Path, out: Path, *, names: Mapping[str, str], binary: bool = False, only_named: bool = False
) -> list[ExportedModel]:
    """Write each model of a reconstruction into its own folder, first the one that is joined on the map.

    Args:
        names: Names of the photos, by the SHA-256 of their files.
        binary: Whether to write COLMAP's binary format, else text.
        only_named: Whether to leave out photos without a name, with the points that only they see.

    Raises:
        IndexDamaged: A model cannot be read, or was replaced meanwhile.
    """
    submodels = read_submodels(folder / SUBMODELS_FILE)
    sources = [*(adjusted_folders(folder, submodels) if submodels else []), *model_folders(folder)]
    exported = []
    for number, source in enumerate(sources):
        target = out / str(number)
        counts = export_model(source, target, names=names, binary=binary, only_named=only_named)
        exported.append(ExportedModel(target, *counts))
    return exported
