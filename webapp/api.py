"""The public Python API: open a map, localize photos, evaluate, make a map from photos.

The interface that `docs/python.md` describes is stable within a major version; everything else in this
package may change. Importing this module loads no web code. Opening a map starts worker processes, so a
script needs the guard `if __name__ == "__main__":`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from PIL import Image

from webapp.configuration import load_settings
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.hypotheses.jsonform import answer_to_json
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.errors import ExpMapError
from webapp.files.contents import connect, settings_at
from webapp.progress import Progress
from webapp.render.answer_pictures import map_picture, match_picture
from webapp.settings import Settings
from webapp.tasks.evaluation.evaluate import evaluate_queries
from webapp.tasks.evaluation.types import EvaluateOptions, Evaluation
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.sequence import SequenceFilter
from webapp.tasks.maps import from_photos
from webapp.tasks.maps.from_photos import PlaceOptions, PlaceReport
from webapp.tasks.satellite.georeference import GeoSource

__all__ = [
    "Answer", "EvaluateOptions", "Evaluation", "ExpMapError", "GeoSource", "Hypothesis", "LatLon", "MapPixel",
    "OpenOptions", "PhotoMap", "PhotoSequence", "PlaceOptions", "PlaceReport", "Progress", "Settings",
    "open_map", "place_photos",
]  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class PhotoMap:
    """A map with its index, ready for queries; made by `open_map`."""

    _pipeline: LocalizationPipeline

    @property
    def photos(self) -> int:
        """Number of photos on the map."""
        return len(self._pipeline.map.experiences)

    @property
    def place_radius_px(self) -> float:
        """Distance, in map pixels, within which a position counts as right."""
        return self._pipeline.place_radius_px

    @property
    def georeference(self) -> Georeference | None:
        """Transformation between map pixels and WGS 84; None where the map has none."""
        return self._pipeline.map.georeference

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the map's image, map pixels."""
        satellite = self._pipeline.map.satellite
        return satellite.width, satellite.height

    def localize(self, photo: str | Path, *, top: int = 5, fov_deg: float | None = None) -> Answer:
        """Localize one photo.

        Args:
            top: Maximum number of hypotheses.
            fov_deg: Horizontal field of view of the upright photo; overrides that given to `open_map` and
                EXIF.

        Returns:
            The most probable place first. `abstained` is true where "not on this map" is more probable.

        Raises:
            PhotoError: The photo cannot be read.
        """
        pipeline = self._pipeline if fov_deg is None else replace(self._pipeline, fov_deg=fov_deg)
        return pipeline.localize(Path(photo), top=top)

    def start_sequence(self, *, speed_px: float | None = None, fov_deg: float | None = None) -> PhotoSequence:
        """Start a sequence of consecutive photos: each is localized with the help of the previous ones.

        Args:
            speed_px: Typical distance between consecutive photos, map pixels; by default that of most
                sequences.
            fov_deg: As in `localize`.
        """
        pipeline = self._pipeline if fov_deg is None else replace(self._pipeline, fov_deg=fov_deg)
        return PhotoSequence(SequenceFilter(pipeline, speed_px=speed_px))

    def as_json(self, answer: Answer, *, query: str, sequence: bool = False) -> dict[str, Any]:
        """Return the object that `localize --json` prints.

        Args:
            query: Name of the photo.
            sequence: Whether the photo was one of a sequence.
        """
        source = self._pipeline.answer_source(sequence=sequence)
        return answer_to_json(answer, query=query, source=source)

    def map_picture(self, answer: Answer) -> Image.Image:
        """Draw the hypotheses on the map.

        Raises:
            PhotoError: The map's image cannot be used.
        """
        pipeline = self._pipeline
        limits = pipeline.settings.photo
        return map_picture(pipeline.cfg, pipeline.map, answer=answer, limits=limits)

    def match_picture(self, photo: str | Path, answer: Answer) -> Image.Image | None:
        """Draw the photo next to the best map photo, with lines between matches; None if nothing matches.

        Raises:
            PhotoError: One of the photos cannot be used.
        """
        pipeline = self._pipeline
        limits = pipeline.settings.photo
        cfg, the_map = pipeline.cfg, pipeline.map
        return match_picture(cfg, the_map, query=Path(photo), answer=answer, limits=limits)

    def latlon_of(self, hypothesis: Hypothesis) -> LatLon | None:
        """Return a hypothesis's latitude and longitude, WGS 84; None if the map has no georeference."""
        return self.georeference.latlon_of(hypothesis.position) if self.georeference else None

    def evaluate(
        self, queries: str | Path, *, options: EvaluateOptions | None = None, progress: Progress | None = None
    ) -> Evaluation:
        """Measure the accuracy on photos with known positions.

        Args:
            queries: Table `path;x;y` with a header; paths are relative to it, positions are map pixels.
            progress: One step per photo.

        Returns:
            `summary` has the figures, `results` one entry per query.

        Raises:
            TableError: The table cannot be read.
        """
        folder = self._pipeline.cfg.parent
        return evaluate_queries(
            self._pipeline, Path(queries), map_folder=folder, options=options, progress=progress
        )


@dataclass(frozen=True, slots=True, eq=False)
class PhotoSequence:
    """Consecutive photos; made by `PhotoMap.start_sequence`."""

    _filter: SequenceFilter

    def localize(self, photo: str | Path, *, top: int = 5) -> Answer:
        """Localize the next photo.

        Raises:
            PhotoError: The photo cannot be read; the sequence continues without it.
        """
        return self._filter.localize(Path(photo), top=top)


def open_map(
    cfg: str | Path,
    options: OpenOptions | None = None,
    *,
    fov_deg: float | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> PhotoMap:
    """Open a map: bring its index up to date, calibrate it if necessary, and load it.

    Args:
        cfg: The map file.
        options: Method, features, folder of the index.
        fov_deg: Horizontal field of view of the queries; overrides their EXIF.
        settings: By default what the environment and the configuration file set.
        progress: One step per photo whose features have to be extracted.

    Raises:
        MapError: The map cannot be read.
        UsageError: The features do not fit the method.
        NotReady: Model weights or an optional package are missing.
        StorageError: The map is in a library whose photos are in another object storage than the settings
            name.
    """
    chosen = settings_at(Path(cfg), settings or load_settings())
    if chosen.storage is not None:
        connect(chosen)
    pipeline = open_pipeline(
        Path(cfg),
        options or OpenOptions(),
        settings=chosen,
        progress=progress or Progress(),
        fov_deg=fov_deg,
    )
    return PhotoMap(pipeline)


def place_photos(
    folder: str | Path,
    options: PlaceOptions,
    *,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> PlaceReport:
    """Make a map from the photos of a folder, placed by their EXIF GPS or a table of positions.

    Args:
        folder: Searched recursively.
        options: The map file to write, and the image with its georeference.
        settings: By default what the environment and the configuration file set.
        progress: One step per file.

    Returns:
        Every file, placed or not, with the reason.

    Raises:
        UsageError: The map exists already, or no georeference is known.
        GeoreferenceError, TableError, PhotoError: The georeference, the positions or the image cannot be
            read.
    """
    return from_photos.map_from_photos(
        Path(folder),
        options=options,
        settings=settings or load_settings(),
        progress=progress or Progress(),
    )
