"""XML whose names take far more memory than its file has bytes is refused wherever XML is read."""

import io
import tracemalloc

import pytest
from PIL import Image, PngImagePlugin

from webapp.errors import GeoreferenceError, TrackError
from webapp.files.exchange import xml
from webapp.files.exchange.xml import walk
from webapp.files.maps.positions import read_positions
from webapp.files.photos.photo import read_facts
from webapp.files.photos.sidecars import Sidecar, with_sidecars
from webapp.files.satellite.georeference_files import read_geotiff
from webapp.missions.files.track_format import Beginning
from webapp.settings import PhotoLimits

LONG = "u" * 100_000
ELEMENTS = "".join(f"<a:b{n}/>" for n in range(2000))
ATTRIBUTES = " ".join(f'a:b{n}=""' for n in range(2000))
MOST_BYTES = 80_000_000
"""Far less than the 200 MB and more that the names of these files take."""


@pytest.fixture
def peak():
    """Return the most memory taken since the test began, bytes."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()


def hostile(root="r"):
    return f'<{root} xmlns:a="{LONG}">{ELEMENTS}</{root}>'


def photo(xmp=None):
    file, info = io.BytesIO(), PngImagePlugin.PngInfo()
    if xmp is not None:
        info.add_itxt("XML:com.adobe.xmp", xmp, zip=True)
    Image.new("RGB", (40, 30)).save(file, "PNG", pnginfo=info)
    return file.getvalue()


def test_an_element_with_millions_of_others_inside_is_refused(monkeypatch):
    monkeypatch.setattr(xml, "MOST_INSIDE", 1000)
    wanted = b"<kml>" + b"<Placemark><a/></Placemark>" * 2000 + b"</kml>"
    assert sum(1 for _ in walk(io.BytesIO(wanted), whole={"Placemark"})) == 2002
    hostile = b"<kml><Placemark>" + b"<a/>" * 2000 + b"</Placemark></kml>"
    with pytest.raises(TrackError, match="more than 1000 others inside"):
        list(walk(io.BytesIO(hostile), whole={"Placemark"}))


def test_the_xmp_of_a_photo(peak):
    data = photo(hostile())
    assert len(data) < 10_000
    assert "XMP is damaged" in read_facts(data, limits=PhotoLimits()).notes[0]
    assert peak() < MOST_BYTES


def test_a_file_beside_a_photo(peak):
    facts = read_facts(photo(), limits=PhotoLimits())
    assert "damaged" in with_sidecars(facts, [Sidecar("a.xmp", hostile().encode())]).notes[0]
    assert peak() < MOST_BYTES


def test_the_beginning_of_a_file_with_tracks(tmp_path, peak):
    path = tmp_path / "a.gpx"
    path.write_text(f'<gpx xmlns:a="{LONG}" {ATTRIBUTES}/>')
    with pytest.raises(TrackError, match="namespace of more than"):
        _ = Beginning(path).root
    assert peak() < MOST_BYTES


def test_a_list_of_positions(tmp_path, peak):
    path = tmp_path / "a.kml"
    path.write_text(hostile("kml"))
    with pytest.raises(TrackError, match="namespace of more than"):
        read_positions(path)
    assert peak() < MOST_BYTES


def test_a_file_next_to_a_geotiff(tmp_path, peak):
    path = tmp_path / "s.tif"
    Image.new("RGB", (8, 8)).save(path)
    (tmp_path / "s.tif.aux.xml").write_text(hostile("PAMDataset"))
    with pytest.raises(GeoreferenceError, match="namespace of more than"):
        read_geotiff(path)
    assert peak() < MOST_BYTES


@pytest.mark.parametrize("codec", ["utf-8", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize(
    "declared",
    [
        f'xmlns:a="{LONG}"',
        f"xmlns:a =\n '{LONG}'",
        f'xmlns:a{" " * 40_000}="{LONG}"',
        f'xmlns:{"a" * 40_000}="{LONG}"',
        f"xmlns:a='{chr(0x2227) * 400}'",  # UTF-16 has the byte of a quotation mark
        " ".join(f'b{n}=""' for n in range(12_000)),
    ],
    ids=["plain", "lines", "blanks", "prefix", "quotes", "attributes"],
)
def test_no_way_of_writing_it_is_overlooked(declared, codec):
    file = io.BytesIO(f"<r><s {declared}/></r>".encode(codec))
    with pytest.raises(TrackError, match=r"more than \d+ (characters|attributes)"):
        list(walk(file, whole=()))


def test_many_short_names_are_refused():
    text = f'<r xmlns:a="{"u" * 200}">' + "".join(f"<a:b{n}/>" for n in range(12_000)) + "</r>"
    with pytest.raises(TrackError, match="different names"):
        list(walk(io.BytesIO(text.encode()), whole=()))


def test_texts_about_namespaces_are_read():
    inner = f"xmlns is {LONG} <![CDATA[<svg xmlns='http://www.w3.org/2000/svg'>{' =' * 20_000}]]>"
    found = list(walk(io.BytesIO(f'<r xmlns="urn:x"><s>{inner}</s></r>'.encode()), whole=()))
    assert len(found) == 4
