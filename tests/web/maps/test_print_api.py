"""A map printed through the API, with chosen answers, in the language of the page."""

import io
import json

import pytest
from PIL import Image

from webapp.render.sheet import make
from webapp.store import queries
from webapp.store.schema import MapRecord, QueryRecord

CORNERS = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.098, "lon": 14.403}}


@pytest.fixture
def url(client, park):
    """The address of a georeferenced map."""
    file = io.BytesIO()
    Image.new("RGB", (300, 200), "green").save(file, "PNG")
    file.seek(0)
    satellite = {"file": (file, "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"/api/v1/maps/{park}/satellite", data=satellite).status_code == 200
    return f"/api/v1/maps/{park}"


def ask(library, slug, name, x):
    best = {"x_px": x, "y_px": 50.0, "probability": 0.7, "radius_px": 5.0, "heading_deg": None}
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        facts = {"file": "f.jpg", "width": 4, "height": 3, "options": {}, "evidence": []}
        row = QueryRecord(name=name, answer={"hypotheses": [best], "off_map_probability": 0.1}, **facts)
        queries.add(session, record, row=row, most=10)
        return row.id


def test_the_sheet_is_a_file_of_the_chosen_kind_and_size(client, url):
    png = client.get(f"{url}/print.png?paper=a3&orientation=portrait&dpi=40")
    assert (png.status_code, png.content_type) == (200, "image/png")
    assert Image.open(io.BytesIO(png.data)).size == (468, 661)
    pdf = client.get(f"{url}/print.pdf")
    assert (pdf.status_code, pdf.content_type) == (200, "application/pdf")
    assert pdf.data.startswith(b"%PDF-")
    assert "filename=park.pdf" in pdf.headers["Content-Disposition"]


@pytest.mark.parametrize("query", ["paper=a5", "dpi=4000", "labels=all", "orientation=up", "headings=maybe"])
def test_what_cannot_be_printed_is_refused(client, url, query):
    assert client.get(f"{url}/print.png?{query}").status_code == 422


def test_a_map_without_an_image_says_so(client, park):
    answer = client.get(f"/api/v1/maps/{park}/print.pdf")
    assert answer.status_code == 400
    assert "no satellite image" in answer.json["error"]["message"]


def test_answers_and_words_are_those_that_are_wanted(client, url, park, library, monkeypatch):
    sheets = []

    def remember(content, *, form, options, words):
        sheets.append((content, options, words.looks, words.photos(3)))
        return b"sheet"

    monkeypatch.setattr(make, "draw_sheet", remember)
    first, second = (ask(library, park, f"{n}.jpg", 10.0 * n) for n in range(2))
    client.get(f"{url}/print.png")
    client.get(f"{url}/print.png?answers=true&first={second}&last={second}&title=Hi&control_points=true")
    client.get(f"{url}/print.png?answers=true", headers={"Accept-Language": "cs"})
    client.get(f"{url}/print.png?answers=true&mine=true")
    assert [[a.name for a in content.answers] for content, *_ in sheets] == [
        [],
        ["1.jpg"],
        ["0.jpg", "1.jpg"],
        [],
    ]
    assert first < second
    _, options, *english = sheets[1]
    assert (options.title, options.control_points) == ("Hi", True)
    assert english == ["direction of view", "3 photos"]
    assert sheets[2][2:] == ("směr pohledu", "3 fotky")


def test_the_tile_service_is_named(client, url, park, library, monkeypatch):
    monkeypatch.setattr(
        make, "draw_sheet", lambda content, *, form, options, words: options.attribution.encode()
    )
    assert client.get(f"{url}/print.png").data == b""
    folder = library.map_folder(park)
    (image,) = folder.glob("satellite-*.png")
    image.with_suffix(".json").write_text(json.dumps({"attribution": "© Tiles"}))
    assert client.get(f"{url}/print.png").data.decode() == "© Tiles"
    assert client.get(f"{url}/print.png?attribution=Me").data == b"Me"
