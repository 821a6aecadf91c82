"""A printed map: what is on the sheet and where, and only known facts."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.core.mapmodel.notes import MapNote
from webapp.render.sheet import marks
from webapp.render.sheet.drawing import Box, LabelWanted, place_labels, shorten, text_width
from webapp.render.sheet.make import SheetContent, compose, draw_sheet
from webapp.render.sheet.options import SheetAnswer, SheetOptions, answers_from_json, english

WORDS = english("1 May 2026")
SIZE = SheetOptions(orientation="landscape").page_sizes()[0]
TURNED = Georeference("EPSG:32633", (0.0, -0.5, 500_000, -0.5, 0.0, 5_500_000, 0, 0, 1), "affine")
"""Half a metre per pixel, east up."""

MAP = Map(
    SatelliteImage("plan.png", 800, 500),
    tuple(
        Experience(n, f"photos/IMG_{n:04}.jpg", MapPixel(100.0 + 60 * n, 200), heading_deg=45.0 * n)
        for n in range(5)
    ),
    TURNED,
    control_points=(GroundControlPoint("Gate", MapPixel(300, 400)), GroundControlPoint("Lost")),
)
IMAGE = np.full((500, 800, 3), 90, np.uint8)


class Recorded:
    """Records what is drawn."""

    def __init__(self):
        self.texts, self.discs, self.images = [], [], []

    def image(self, pixels, box):
        self.images.append((pixels.shape, box))

    def disc(self, centre, radius, *, colour, opacity=1.0):
        self.discs.append((centre, radius, colour))

    def ring(self, centre, radius, *, colour, width):
        pass

    def polygon(self, corners, *, colour):
        pass

    def line(self, start, end, *, colour, width):
        pass

    def text(self, at, text, *, style):
        self.texts.append((text, at, style))

    def finish(self):
        return b""

    @property
    def words(self):
        return [text for text, _, _ in self.texts]


def drawn(map_=MAP, *, answers=(), **options):
    sheet = Recorded()
    content = SheetContent(map_, IMAGE, "Park", tuple(answers))
    compose(sheet, content, size=SIZE, options=SheetOptions(**options), words=WORDS)
    return sheet


def test_the_scale_bar_is_as_long_as_its_metres_on_the_paper():
    sheet = drawn()
    ((_, frame),) = sheet.images
    points_per_metre = (frame.right - frame.left) / 800 / 0.5
    ends = {text: at[0] for text, at, _ in sheet.texts if text in ("0", "50 m")}
    assert ends["50 m"] - ends["0"] == pytest.approx(50 * points_per_metre, rel=1e-3)
    (ratio,) = (text for text in sheet.words if text.startswith("1 : "))
    assert int("".join(filter(str.isdigit, ratio[4:]))) == pytest.approx(
        72 / 0.0254 / points_per_metre, rel=5e-3
    )
    assert "N" in sheet.words


def test_without_a_georeference_no_scale_and_no_north_are_invented():
    words = drawn(replace(MAP, georeference=None)).words
    assert WORDS.no_scale in words
    assert "N" not in words
    assert not [text for text in words if text.endswith(" m") or text.startswith("1 : ")]


def test_north_is_found_as_the_georeference_has_it():
    positions = [MapPixel(10, 20), MapPixel(700, 400)]
    expected = [TURNED.north_deg(position) for position in positions]
    assert marks.norths(TURNED, positions) == pytest.approx(expected, abs=1e-3)
    assert marks.norths(None, positions).tolist() == [0.0, 0.0]


def test_marks_are_where_they_are_on_the_image():
    sheet = drawn(labels="none")
    ((_, frame),) = sheet.images
    scale = (frame.right - frame.left) / 800
    photos = {
        centre
        for centre, _, colour in sheet.discs
        if colour == marks.PHOTO and frame.top < centre[1] < frame.bottom
    }
    expected = [
        (frame.left + e.position.x * scale, frame.top + e.position.y * scale) for e in MAP.experiences
    ]
    assert np.array(sorted(photos)) == pytest.approx(np.array(sorted(expected)))


def test_photos_are_named_as_chosen_and_those_on_one_spot_together():
    assert {"0", "1", "2", "3", "4"} <= set(drawn().words)
    assert "IMG_0003" in drawn(labels="names").words
    assert not {"1", "IMG_0001"} & set(drawn(labels="none").words)
    same = tuple(replace(e, position=MapPixel(300, 300)) for e in MAP.experiences)
    assert "0 +4" in drawn(replace(MAP, experiences=same)).words


def test_control_points_and_answers_are_shown_where_they_are_wanted():
    assert "Gate" not in drawn().words
    words = drawn(
        control_points=True, answers=[SheetAnswer("query.jpg", MapPixel(500, 300), 0.8, 30.0, 90.0)]
    ).words
    assert {"Gate", WORDS.control_point, "query.jpg", WORDS.answer, WORDS.radius} <= set(words)
    assert "Lost" not in words


def test_notes_are_numbers_with_what_they_say_below_the_map():
    spots = ((1, "Bench", MapPixel(300, 300)), (2, "Lost", None), (5, "Gate", MapPixel(500, 100)))
    map_ = replace(
        MAP, notes=tuple(MapNote(id, title, at, "Since May.\nTwo seats.") for id, title, at in spots)
    )
    tall = SheetOptions(orientation="portrait")
    sheet = Recorded()
    content = SheetContent(map_, IMAGE, "Park")
    compose(sheet, content, size=tall.page_sizes()[0], options=tall, words=WORDS)
    ((_, frame),) = sheet.images
    below = [text for text, (_, y), _ in sheet.texts if y > frame.bottom]
    assert below.index("Bench") < below.index("Gate")
    assert below.count("Since May.") == below.count("Two seats.") == 2
    assert "Lost" not in below
    assert "Bench" not in drawn(map_, notes=False).words


def test_notes_without_room_are_counted():
    notes = tuple(MapNote(n, f"Note {n}", MapPixel(9.0 * n, 50), "word " * 300) for n in range(1, 40))
    words = drawn(replace(MAP, notes=notes)).words
    shown = sum(text.startswith("Note ") for text in words)
    assert WORDS.notes_left_out.format(n=39 - shown) in words


def test_answers_are_the_best_places_of_photos_that_are_on_the_map():
    best = {"x_px": 3.0, "y_px": 4.0, "probability": 0.6, "radius_px": None, "heading_deg": 10.0}
    answers = [
        {"query": "a.jpg", "hypotheses": [best, {**best, "x_px": 9.0}], "off_map_probability": 0.2},
        {"query": "b.jpg", "hypotheses": [best], "off_map_probability": 0.7},
        {"query": "c.jpg", "hypotheses": []},
        {"query": "d.jpg", "error": "damaged"},
    ]
    assert answers_from_json(answers) == (SheetAnswer("a.jpg", MapPixel(3.0, 4.0), 0.6, None, 10.0),)


def test_labels_overlap_nothing_and_stay_in_the_frame():
    rng = np.random.default_rng(5)
    frame = Box(0, 0, 400, 300)
    at = rng.uniform((5, 5), (395, 295), (300, 2))
    dots = [Box(x - 2, y - 2, x + 2, y + 2) for x, y in at.tolist()]
    boxes = place_labels([LabelWanted(x, y, 3, 24, 7) for x, y in at.tolist()], taken=dots, frame=frame)
    placed = [box for box in boxes if box is not None]
    assert 50 < len(placed) < 300
    assert all(box.within(frame) for box in placed)
    assert not any(a.overlaps(b) for n, a in enumerate(placed) for b in [*placed[:n], *dots])


def test_labels_without_room_are_counted():
    crowd = tuple(Experience(n, f"{n}.jpg", MapPixel(300.0 + n % 20, 200.0 + n // 20)) for n in range(200))
    sheet = drawn(replace(MAP, experiences=crowd))
    shown = sum(text.split(" ")[0].isdigit() and style.halo > 0 for text, _, style in sheet.texts)
    (note,) = (text for text in sheet.words if "left out" in text)
    assert 0 < shown < 200
    assert int(note.split()[0]) + shown == 200


def test_around_the_photos_they_fill_the_sheet():
    ((_, whole),) = drawn().images
    few = tuple(replace(e, position=MapPixel(400.0 + e.id, 250)) for e in MAP.experiences)
    sheet = drawn(replace(MAP, experiences=few), extent="photos", labels="none")
    ((_, frame),) = sheet.images
    at = [c[0] for c, _, colour in sheet.discs if colour == marks.PHOTO and frame.top < c[1] < frame.bottom]
    assert max(at) - min(at) > 4 * (whole.right - whole.left) / 800 * 4


def test_a_long_title_has_two_lines_that_fit():
    width = SIZE[0] - 2 * 34
    sheet = drawn(title="Příliš žluťoučký kůň úpěl ďábelské ódy " * 8)
    lines = [text for text, _, style in sheet.texts if style.bold and style.size == 20]
    assert len(lines) == 2
    assert all(text_width(line, 20, bold=True) <= width for line in lines)
    assert lines[1].endswith("…")
    assert shorten("short", 20, width=100) == "short"


def test_files_have_the_size_of_the_paper_and_are_the_same_each_time():
    content = SheetContent(MAP, IMAGE, "Náměstí", (SheetAnswer("q", MapPixel(500, 300), 0.8, 30.0, 90.0),))
    options = SheetOptions(paper="letter", orientation="portrait", dpi=60, control_points=True)
    png = draw_sheet(content, form="png", options=options, words=WORDS)
    assert Image.open(io.BytesIO(png)).size == (510, 660)
    pdf = draw_sheet(content, form="pdf", options=options, words=WORDS)
    assert pdf.startswith(b"%PDF-")
    assert b"/MediaBox [ 0 0 612 792 ]" in pdf
    assert pdf == draw_sheet(content, form="pdf", options=options, words=WORDS)


def test_the_orientation_is_the_one_in_which_the_map_is_larger():
    def size(width, height):
        map_ = replace(
            MAP, satellite=SatelliteImage("plan.png", width, height), experiences=MAP.experiences[:1]
        )
        content = SheetContent(map_, np.zeros((height, width, 3), np.uint8), "Park")
        return Image.open(
            io.BytesIO(draw_sheet(content, form="png", options=SheetOptions(dpi=40), words=WORDS))
        ).size

    assert size(800, 300) == (468, 331)
    assert size(300, 800) == (331, 468)


def test_a_map_without_photos_is_a_map():
    assert "0 photos  ·  1 May 2026" in drawn(replace(MAP, experiences=()), extent="photos").words
