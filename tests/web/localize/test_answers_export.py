"""Answers as files: a table, waypoints and points, of all or only one's own."""

import csv
import io
import json
from xml.etree import ElementTree as ET

import pytest

from webapp.store import queries as stored
from webapp.store.schema import MapRecord, QueryRecord

FOUND = {
    "rank": 1,
    "kind": "position",
    "x_px": 10.5,
    "y_px": 20.0,
    "lat": 50.1,
    "lon": 14.2,
    "radius_m": 3.0,
    "heading_deg": 90.0,
    "probability": 0.75,
}
GPX = "{http://www.topografix.com/GPX/1/1}"


@pytest.fixture
def park(library, owner, new_account, new_map):
    """A map with two answers of the owner and one of another person."""
    slug, other = new_map(owner), new_account("eva")
    answers = [
        (owner, "=cmd.jpg", {"hypotheses": [FOUND], "off_map_probability": 0.1}),
        (
            other,
            "b & c.jpg",
            {"hypotheses": [{**FOUND, "lat": None, "lon": None}], "off_map_probability": None},
        ),
        (owner, "off.jpg", {"hypotheses": [], "off_map_probability": None}),
    ]
    with library.database.write() as session:
        record = session.query(MapRecord).one()
        for account, name, answer in answers:
            row = QueryRecord(
                account_id=account.id,
                name=name,
                file="0.jpg",
                width=4,
                height=3,
                options={},
                answer=answer,
                evidence=[],
            )
            stored.add(session, record, row=row, most=10)
    return slug


def test_a_table_has_a_line_for_each_photo(client, park):
    answer = client.get(f"/api/v1/maps/{park}/queries/answers.csv")
    assert answer.headers["Content-Disposition"] == f"attachment; filename={park}-answers.csv"
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [row["photo"] for row in rows] == ["'=cmd.jpg", "b & c.jpg", "off.jpg"]
    assert (rows[0]["lat"], rows[0]["probability"], rows[0]["radius_m"]) == ("50.1", "0.75", "3.0")
    assert (rows[1]["x_px"], rows[1]["lat"], rows[2]["probability"]) == ("10.5", "", "")


def test_points_are_where_the_photos_were_found(client, park):
    answer = client.get(f"/api/v1/maps/{park}/queries/answers.geojson")
    features = json.loads(answer.data)["features"]
    assert [one["geometry"] and one["geometry"]["coordinates"] for one in features] == [
        [14.2, 50.1],
        None,
        None,
    ]
    assert features[0]["properties"]["probability"] == 0.75
    (point,) = ET.fromstring(client.get(f"/api/v1/maps/{park}/queries/answers.gpx").data).iter(f"{GPX}wpt")
    assert (point.get("lat"), point.findtext(f"{GPX}name")) == ("50.100000000", "=cmd.jpg")


def test_a_range_and_ones_own(client, park, stranger):
    def names(query):
        text = client.get(f"/api/v1/maps/{park}/queries/answers.csv?{query}").text
        return [row["photo"] for row in csv.DictReader(io.StringIO(text))]

    assert names("first=2") == ["b & c.jpg", "off.jpg"]
    assert names("first=1&last=2") == ["'=cmd.jpg", "b & c.jpg"]
    assert names("mine=true&first=1&last=3") == ["'=cmd.jpg", "off.jpg"]
    assert client.get(f"/api/v1/maps/{park}/queries/answers.exe").status_code == 404
    assert stranger.get(f"/api/v1/maps/{park}/queries/answers.csv").status_code == 401
