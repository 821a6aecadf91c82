"""Altitudes are read from the files of photos, once."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.landmarks.heights import Altitude, Altitudes
from webapp.core.landmarks.placing import KnownPositions
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.errors import Cancelled
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import altitudes
from webapp.tasks.landmarks.adjust import Facts, _key_of, positions_of
from webapp.tasks.landmarks.altitudes import known_altitudes, read_altitudes

TENTH = Georeference("EPSG:32635", (0.1, 0.0, 470_683.0, 0.0, -0.1, 6_696_811.0, 0.0, 0.0, 1.0), "corners")
"""Metres per pixel."""

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:GpsLatitude="50.1" '
    'drone-dji:GpsLongitude="14.2" drone-dji:AbsoluteAltitude="{}" drone-dji:RelativeAltitude="{}"/>'
    "</rdf:RDF></x:xmpmeta>"
)


@pytest.fixture
def photos(tmp_path):
    """Photos by content: of a drone, with an absurd height, and without metadata."""
    xmp = {"drone": XMP.format("+320.5", "+60.1"), "absurd": XMP.format("320.5", "6e9"), "plain": ""}
    for name, text in xmp.items():
        Image.new("RGB", (40, 30)).save(tmp_path / f"{name}.jpg", **({"xmp": text.encode()} if text else {}))
    return {name: Experience(n, f"{name}.jpg", MapPixel(5.0, 5.0)) for n, name in enumerate(xmp)}


def read(tmp_path, photos, progress=None):
    return read_altitudes(
        tmp_path / "map.cfg",
        photos,
        folder=tmp_path,
        limits=Settings().photo,
        progress=progress or Progress(),
    )


def test_they_are_read_once_from_what_drones_write(tmp_path, photos, monkeypatch):
    expected = {"drone": Altitude(320.5, 60.1), "absurd": Altitude(320.5), "plain": Altitude()}
    assert read(tmp_path, photos) == expected
    monkeypatch.setattr(altitudes, "read_facts", None)
    assert read(tmp_path, photos) == expected
    assert read(tmp_path, {"drone": photos["drone"]}) == {"drone": Altitude(320.5, 60.1)}


def test_reading_can_be_stopped_and_what_was_read_is_kept(tmp_path, photos, monkeypatch):
    class Stopped(Progress):
        asked = 0

        def cancelled(self):
            self.asked += 1
            return self.asked == 3

    monkeypatch.setattr(altitudes, "_KEPT_EACH", 2)
    with pytest.raises(Cancelled):
        read(tmp_path, photos, Stopped())
    assert json.loads((tmp_path / "altitudes.json").read_text()).keys() == {"absurd", "drone"}
    assert len(read(tmp_path, photos)) == 3


def test_the_views_of_a_panorama_read_its_file_once(tmp_path, photos, monkeypatch):
    views = {f"view {n}": photos["drone"] for n in range(8)}
    opened = []

    def counting(path, **options):
        opened.append(path.name)
        return read_facts(path, **options)

    monkeypatch.setattr(altitudes, "read_facts", counting)
    assert set(read(tmp_path, views).values()) == {Altitude(320.5, 60.1)}
    assert opened == ["drone.jpg"]


@pytest.mark.parametrize("damaged", ["", "[]", '{"drone": 7}', '{"drone": {"height": 3}}'])
def test_a_damaged_file_is_replaced(tmp_path, photos, damaged):
    (tmp_path / "altitudes.json").write_text(damaged)
    assert read(tmp_path, photos)["drone"] == Altitude(320.5, 60.1)
    assert json.loads((tmp_path / "altitudes.json").read_text())["plain"] == {
        "above_sea_m": None,
        "above_start_m": None,
    }


def test_a_photo_that_is_gone_is_left_out_and_read_later(tmp_path, photos):
    content = (tmp_path / "drone.jpg").read_bytes()
    (tmp_path / "drone.jpg").unlink()
    assert "drone" not in read(tmp_path, photos)
    (tmp_path / "drone.jpg").write_bytes(content)
    assert read(tmp_path, photos)["drone"] == Altitude(320.5, 60.1)


def test_they_need_a_georeference_and_are_part_of_the_key_of_an_adjustment():
    the_map = Map(SatelliteImage("s.png", 1000, 1000), ())
    assert known_altitudes({0: Altitude(1.0, 2.0)}, the_map, count=2) is None
    there = replace(the_map, georeference=TENTH)
    found = known_altitudes({0: Altitude(1.0, 2.0)}, there, count=2)
    assert found.photos == (Altitude(1.0, 2.0), Altitude())
    assert found.px_per_m == pytest.approx(10.0, rel=0.01)
    known = KnownPositions(np.zeros(2, np.complex128), np.ones(2), np.zeros(2, np.bool_))
    others = [
        None,
        found,
        replace(found, photos=(Altitude(1.0, 2.1), Altitude())),
        Altitudes(found.photos, 9.0),
    ]
    assert len({_key_of(known, there, one) for one in others}) == 4


def test_a_position_that_is_confirmed_by_hand_changes_the_key_of_an_adjustment():
    """It can then be left out to measure the error."""
    the_map = Map(SatelliteImage("s.png", 1000, 1000), ())
    derived = KnownPositions(np.zeros(2, np.complex128), np.ones(2), np.ones(2, np.bool_))
    by_hand = replace(derived, derived=np.zeros(2, np.bool_))
    assert _key_of(derived, the_map) != _key_of(by_hand, the_map)


@pytest.mark.parametrize(
    ("above_sea_m", "flight", "height_px"),
    [((300.0, None), [-1] * 7, None), ((300.0, 400.0), [0] * 7, [-500.0] * 6 + [500.0])],
    ids=["alone", "with another photo"],
)
def test_a_panorama_is_one_photo_with_one_height(above_sea_m, flight, height_px):
    """Its six views are neither a flight of their own, nor six heights in the mean of one."""
    photo = np.array([0] * 6 + [1])
    known = KnownPositions(np.array([0.0] * 6 + [9000.0j]), np.ones(7), np.zeros(7, np.bool_))
    both = Altitudes(tuple(Altitude(above_sea_m[number]) for number in photo), 10.0)
    heights = positions_of(
        [f"{n}" for n in range(7)], Facts(known, altitudes=both), photo=photo, turn_deg=np.zeros(7, np.int64)
    ).heights
    assert heights.flight.tolist() == flight
    if height_px is not None:
        assert heights.height_px == pytest.approx(height_px, rel=0.3)
        assert heights.height_px[0] == -heights.height_px[6]
