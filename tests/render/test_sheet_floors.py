"""A printed floor of a map: its plan, only its photos, and its name."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from webapp.core.geo.floors import Floor, FloorImage
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.core.mapmodel.notes import MapNote
from webapp.errors import UsageError
from webapp.render.sheet import make
from webapp.render.sheet.make import draw_book
from webapp.render.sheet.options import SheetAnswer, SheetOptions, english
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Source


@pytest.fixture
def source(tmp_path):
    Image.new("RGB", (400, 300), (0, 0, 200)).save(tmp_path / "base.png")
    Image.new("RGB", (100, 150), (200, 0, 0)).save(tmp_path / "plan.png")
    left_half = FloorImage("plan.png", 100, 150, (2.0, 0.0, 0.0, 0.0, 2.0, 0.0))
    map_ = Map(
        SatelliteImage("base.png", 400, 300),
        (Experience(0, "a.jpg", MapPixel(100, 100)), Experience(1, "b.jpg", MapPixel(100, 100), floor=1)),
        floors=(Floor(0, "Ground floor", 0.0), Floor(1, "1st floor", 1.0, None, left_half)),
        title="Museum",
        notes=(MapNote(1, "Lift", MapPixel(9, 9)), MapNote(2, "Attic", MapPixel(9, 9), floor=1)),
    )
    return Source(map_, tmp_path / "map.cfg", "Museum", "museum", lambda _id: ())


def printed(source, monkeypatch, floor):
    """Return what is drawn on the sheet."""
    seen = []

    def drawn(content, **_options):
        seen.append(content)
        return b""

    monkeypatch.setattr(make, "draw_sheet", drawn)
    answers = tuple(SheetAnswer(f"{n}.jpg", MapPixel(9, 9), 0.9, floor=n) for n in (0, 1))
    make.print_map(
        source,
        form="png",
        options=SheetOptions(dpi=40, floor=floor),
        words=english("today"),
        settings=Settings(),
        answers=answers,
    )
    return seen[0]


def test_a_further_floor_is_its_plan_over_the_faint_image_of_the_map(source, monkeypatch):
    content = printed(source, monkeypatch, 1)
    assert (content.title, [e.id for e in content.map.experiences]) == ("Museum – 1st floor", [1])
    assert [answer.name for answer in content.answers] == ["1.jpg"]
    assert [note.title for note in content.map.notes] == ["Attic"]
    height, width = content.satellite.shape[:2]
    plan, around = content.satellite[height // 2, [width // 4, 3 * width // 4]].astype(int)
    assert np.abs(plan - (200, 0, 0)).max() < 5
    assert np.abs(around - (166, 166, 236)).max() < 5


def test_the_floor_of_the_maps_image_is_printed_by_default(source, monkeypatch):
    content = printed(source, monkeypatch, SheetOptions().floor)
    assert (content.title, [e.id for e in content.map.experiences]) == ("Museum – Ground floor", [0])
    assert np.abs(content.satellite.reshape(-1, 3).mean(0) - (0, 0, 200)).max() < 2


def test_a_floor_that_is_not_there_is_refused(source, monkeypatch):
    with pytest.raises(UsageError, match="no floor 7"):
        printed(source, monkeypatch, 7)


def book(source, monkeypatch, *, form="pdf", **options):
    """Return the pages of a PDF of all floors, as drawn, and the title of the document."""
    seen = {}

    def drawn(contents, *, title, options, words):
        seen.update(title=title, pages=list(contents))
        return draw_book(seen["pages"], title=title, options=options, words=words)

    monkeypatch.setattr(make, "draw_book", drawn)
    wanted = SheetOptions(floor=None, **{"dpi": 40, **options})
    data = make.print_map(source, form=form, options=wanted, words=english("today"), settings=Settings())
    return data, seen


def test_all_floors_are_pages_of_one_pdf_the_lowest_first(source, monkeypatch):
    cellar = Floor(2, "Cellar", -1.0)
    source = replace(source, map=replace(source.map, floors=(*source.map.floors, cellar)))
    data, seen = book(source, monkeypatch)
    assert data.count(b"/Type /Page\n") == 3
    assert seen["title"] == "Museum"
    assert [page.title for page in seen["pages"]] == [
        "Museum – Cellar",
        "Museum – Ground floor",
        "Museum – 1st floor",
    ]
    assert [[note.title for note in page.map.notes] for page in seen["pages"]] == [[], ["Lift"], ["Attic"]]


def test_a_title_of_ones_own_names_the_floors_too(source, monkeypatch):
    _, seen = book(source, monkeypatch, title="Tour")
    assert (seen["title"], seen["pages"][1].title) == ("Tour", "Tour – 1st floor")


def test_a_map_without_floors_is_one_page(source, monkeypatch):
    map_ = replace(source.map, floors=(), experiences=source.map.experiences[:1], notes=())
    data, seen = book(replace(source, map=map_), monkeypatch, title="Tour")
    assert (data.count(b"/Type /Page\n"), seen["pages"][0].title) == (1, "Tour")


def test_a_picture_of_all_floors_and_too_many_pixels_are_refused(source, monkeypatch):
    with pytest.raises(UsageError, match="only a PDF"):
        book(source, monkeypatch, form="png")
    floors = tuple(Floor(n, f"Floor {n}", float(n)) for n in range(40))
    with pytest.raises(UsageError, match="40 floors do not fit into one file"):
        book(replace(source, map=replace(source.map, floors=floors)), monkeypatch, paper="a3", dpi=400)
