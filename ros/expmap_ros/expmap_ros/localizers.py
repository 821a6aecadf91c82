"""Localizers of images: a map in this process, or a server."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from expmap_ros.client import NoResponse, Uplink
from expmap_ros.geodesy import Origin
from expmap_ros.pictures import Pixels

if TYPE_CHECKING:
    from webapp.api import Answer, PhotoSequence


class NoAnswer(Exception):
    """The localizer cannot answer at present, or cannot localize this image."""


@dataclass(frozen=True, slots=True)
class Question:
    """An image to localize, with its metadata."""

    photo: bytes
    ending: str
    fov_deg: float | None = None
    time_s: float = 0.0
    with_matches: bool = False

    def continues(self, last: Question | None) -> bool:
        """Return whether this image follows the last one; false, for instance, when a bag restarts."""
        return last is not None and self.fov_deg == last.fov_deg and self.time_s >= last.time_s


@dataclass(frozen=True, slots=True)
class Localized:
    """An answer: the object of `localize --json`, and a picture of the matches (red, green, blue)."""

    form: Mapping[str, Any]
    matches: Pixels | None = field(default=None, compare=False)


class Localizer(Protocol):
    """Interface through which a node localizes images."""

    origin: Origin | None

    def localize(self, question: Question) -> Localized:
        """Localize an image. Raises NoAnswer."""

    def close(self) -> None:
        """Release resources."""


class MapLocalizer:
    """A map file, opened in this process through `webapp.api`."""

    def __init__(self, cfg: Path, *, method: str, features: str, top: int, sequence: bool) -> None:
        from webapp.api import MapPixel, OpenOptions, open_map

        self._map = open_map(cfg, OpenOptions(method=method, features=features))  # type: ignore[arg-type]
        self._top = top
        self._is_sequence = sequence
        self._sequence: PhotoSequence | None = None
        self._last: Question | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="expmap-ros-")
        width, height = self._map.size
        centre = MapPixel(width / 2, height / 2)
        georeference = self._map.georeference
        self.origin = None if georeference is None else Origin(*georeference.latlon_of(centre))

    def localize(self, question: Question) -> Localized:
        """Localize an image. Raises NoAnswer."""
        from webapp.api import ExpMapError

        photo = Path(self._folder.name) / f"image{question.ending}"
        photo.write_bytes(question.photo)
        try:
            answer = self._answer(photo, question)
            picture = self._map.match_picture(photo, answer) if question.with_matches else None
        except ExpMapError as error:
            raise NoAnswer(str(error)) from error
        form = self._map.as_json(answer, query="image", sequence=self._is_sequence)
        return Localized(form, None if picture is None else np.asarray(picture.convert("RGB")))

    def _answer(self, photo: Path, question: Question) -> Answer:
        if not self._is_sequence:
            return self._map.localize(photo, top=self._top, fov_deg=question.fov_deg)
        if self._sequence is None or not question.continues(self._last):
            self._sequence = self._map.start_sequence(fov_deg=question.fov_deg)
        self._last = question
        return self._sequence.localize(photo, top=self._top)

    def close(self) -> None:
        """Delete the folder for the images."""
        self._folder.cleanup()


class ServerLocalizer:
    """A map on a server, through the robots' client, which needs the standard library only."""

    origin: Origin | None = None

    def __init__(self, uplink: Uplink, *, slug: str, top: int, sequence: bool) -> None:
        self._uplink = uplink
        self._is_sequence = sequence
        self._sequence = ""
        self._last: Question | None = None
        self._path = f"/maps/{slug}/localize"
        self._top = top

    def localize(self, question: Question) -> Localized:
        """Localize an image; there is no picture of the matches. Raises NoAnswer."""
        fields = {"top": str(self._top)}
        if self._is_sequence:
            fields["sequence"] = self._name_of(question)
        if question.fov_deg is not None:
            fields["fov"] = repr(question.fov_deg)
        name = f"image{question.ending}"
        response = self._uplink.post_file(self._path, question.photo, name=name, fields=fields)
        if isinstance(response, NoResponse) or response.status != 200:
            raise NoAnswer(str(response.as_error()))
        return Localized(response.body)

    def _name_of(self, question: Question) -> str:
        """Return the name of the sequence of an image, by which the server finds the earlier images."""
        if not question.continues(self._last):
            self._sequence = secrets.token_hex(16)
        self._last = question
        return self._sequence

    def close(self) -> None:
        """Close the connection."""
        self._uplink.close()
