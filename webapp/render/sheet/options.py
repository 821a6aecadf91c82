"""Options of a printed map: its content, paper and language."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import is_off_map

Paper = Literal["a4", "a3", "letter"]
PAPERS: tuple[Paper, ...] = get_args(Paper)
Orientation = Literal["auto", "portrait", "landscape"]
ORIENTATIONS: tuple[Orientation, ...] = get_args(Orientation)
Labels = Literal["none", "numbers", "names"]
LABELS: tuple[Labels, ...] = get_args(Labels)
Extent = Literal["image", "photos"]
EXTENTS: tuple[Extent, ...] = get_args(Extent)
SheetFormat = Literal["pdf", "png"]
SHEET_FORMATS: tuple[SheetFormat, ...] = get_args(SheetFormat)

LEAST_DPI, USUAL_DPI, MOST_DPI = 40, 200, 400
MOST_TEXT = 300
"""Characters of a title or an attribution."""

MM = 72 / 25.4
PAPER_SIZES: Mapping[Paper, tuple[float, float]] = {
    "a4": (210 * MM, 297 * MM),
    "a3": (297 * MM, 420 * MM),
    "letter": (612.0, 792.0),
}
"""Width and height upright, points."""


@dataclass(frozen=True, slots=True)
class SheetOptions:
    """How a map is printed."""

    paper: Paper = "a4"
    # "auto", "portrait" or "landscape". "auto" takes the one in which the map is larger.
    orientation: Orientation = "auto"
    dpi: int = USUAL_DPI  # Of a PNG, and of the satellite image in a PDF
    labels: Labels = "numbers"  # "none", "numbers" or "names". Labels of the photos; numbers are their ids.
    headings: bool = True  # Whether the viewing directions of the photos are shown
    control_points: bool = False  # Whether control points are shown, with their names
    notes: bool = True  # Whether notes are shown on the map, with their texts below it
    extent: Extent = "image"  # "image" or "photos". The whole image, or the surroundings of the photos.
    title: str | None = None  # Replaces that of the map
    attribution: str = ""  # Attribution of the image
    # Id of the floor, on a map that has several; None prints each on its own page.
    floor: int | None = BASE_FLOOR

    def page_sizes(self) -> list[tuple[float, float]]:
        """Return width and height of the paper in points, for each allowed orientation."""
        width, height = PAPER_SIZES[self.paper]
        sizes = {"portrait": (width, height), "landscape": (height, width)}
        return list(sizes.values()) if self.orientation == "auto" else [sizes[self.orientation]]


@dataclass(frozen=True, slots=True)
class SheetAnswer:
    name: str
    position: MapPixel
    probability: float
    radius_px: float | None = None
    heading_deg: float | None = None
    floor: int = BASE_FLOOR


def answers_from_json(answers: Iterable[Mapping[str, Any]]) -> tuple[SheetAnswer, ...]:
    """Read the best places from answers as printed by `localize --json`.

    Photos that are more probably not on the map are left out.
    """
    found = []
    for answer in answers:
        for best in answer.get("hypotheses", ())[:1]:
            if is_off_map(best["probability"], answer.get("off_map_probability")):
                continue
            found.append(
                SheetAnswer(
                    str(answer["query"]),
                    MapPixel(float(best["x_px"]), float(best["y_px"])),
                    float(best["probability"]),
                    best.get("radius_px"),
                    best.get("heading_deg"),
                    int(best.get("floor") or BASE_FLOOR),
                )
            )
    return tuple(found)


@dataclass(frozen=True, slots=True)
class SheetWords:
    photos: Callable[[int], str]  # Formats a number of photos
    date: str
    photo: str = "photo"
    looks: str = "direction of view"
    control_point: str = "control point"
    note: str = "note"
    answer: str = "answer, by its probability"
    radius: str = "uncertainty radius"
    labels_left_out: str = "{n} labels left out for lack of space"  # With `{n}`
    notes_left_out: str = "{n} notes left out for lack of space"
    no_scale: str = "No georeference: the scale and north are not known."
    about: str = "about {scale}"
    image: str = "Image: {attribution}"


def english(date: str) -> SheetWords:
    """Return the English words, with the date as printed."""
    return SheetWords(lambda n: f"{n} photo{'s' * (n != 1)}", date)
