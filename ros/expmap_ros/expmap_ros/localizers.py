"""What localizes images: a map in this process, or a server."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from expmap_ros.geodesy import Origin
from expmap_ros.pictures import Pixels


class NoAnswer(Exception):
    """The localizer cannot answer now, or not this image."""


@dataclass(frozen=True, slots=True)
class Question:
    """An image, and what is known of it."""

    photo: bytes
    ending: str
    fov_deg: float | None = None
    time_s: float = 0.0
    with_matches: bool = False


@dataclass(frozen=True, slots=True)
class Localized:
    """An answer: the object of `localize --json`, and the picture of the matches, red, green, blue."""

    form: Mapping[str, Any]
    matches: Pixels | None = field(default=None, compare=False)


class Localizer(Protocol):
    """What a node asks."""

    origin: Origin | None

    def localize(self, question: Question) -> Localized:
        """Localize an image.

        Raises
        ------
        NoAnswer
        """

    def close(self) -> None:
        """Give back what it holds."""


class MapLocalizer:
    """A map file, opened in this process by the program's own interface."""

    def __init__(self, cfg: Path, *, method: str, features: str, top: int) -> None:
        from webapp.api import MapPixel, OpenOptions, open_map

        self._map = open_map(cfg, OpenOptions(method=method, features=features))  # type: ignore[arg-type]
        self._top = top
        self._folder = tempfile.TemporaryDirectory(prefix="expmap-ros-")
        width, height = self._map.size
        centre = MapPixel(width / 2, height / 2)
        georeference = self._map.georeference
        self.origin = None if georeference is None else Origin(*georeference.latlon_of(centre))

    def localize(self, question: Question) -> Localized:
        """Localize an image.

        Raises
        ------
        NoAnswer
        """
        from webapp.api import ExpMapError

        photo = Path(self._folder.name) / f"image{question.ending}"
        photo.write_bytes(question.photo)
        try:
            answer = self._map.localize(photo, top=self._top, fov_deg=question.fov_deg)
            picture = self._map.match_picture(photo, answer) if question.with_matches else None
        except ExpMapError as error:
            raise NoAnswer(str(error)) from error
        form = self._map.as_json(answer, query="image")
        return Localized(form, None if picture is None else np.asarray(picture.convert("RGB")))

    def close(self) -> None:
        """Delete the folder for the images."""
        self._folder.cleanup()


class ServerLocalizer:
    """A map of a server, asked by the robots' client, which needs the standard library only."""

    origin: Origin | None = None

    def __init__(self, server: tuple[str, str], *, slug: str, top: int, timeout_s: float) -> None:
        from expmap_ros.client import Uplink

        self._uplink = Uplink(*server, timeout_s=timeout_s)
        self._path = f"/maps/{slug}/localize"
        self._top = top

    def localize(self, question: Question) -> Localized:
        """Localize an image; there is no picture of the matches.

        Raises
        ------
        NoAnswer
        """
        from expmap_ros.client import NoResponse

        fields = {"top": str(self._top)}
        if question.fov_deg is not None:
            fields["fov"] = repr(question.fov_deg)
        name = f"image{question.ending}"
        response = self._uplink.post_file(self._path, question.photo, name=name, fields=fields)
        if isinstance(response, NoResponse) or response.status != 200:
            raise NoAnswer(str(response.as_error()))
        return Localized(response.body)

    def close(self) -> None:
        """Close the connection."""
        self._uplink.close()
