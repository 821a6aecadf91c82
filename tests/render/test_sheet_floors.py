"""A floor of a map is printed: its plan, its photos alone, and its name."""

import numpy as np
import pytest
from PIL import Image

from webapp.core.geo.floors import Floor, FloorImage
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.errors import UsageError
from webapp.render.sheet import make
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
    )
    return Source(map_, tmp_path / "map.cfg", "Museum", "museum")


def printed(source, monkeypatch, floor):
    """What is drawn on the sheet."""
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
