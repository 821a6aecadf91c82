"""OGC API - Features: what Part 1 (OGC 17-069) demands of the core and of GeoJSON, and who sees what."""

import re
from datetime import datetime

import numpy as np
import pytest

from webapp.connect.gis import ogc_collections
from webapp.connect.gis.ogc_query import parse_items
from webapp.errors import UsageError
from webapp.store.accounts import accounts
from webapp.store.schema import MapRecord

ROOT = "/api/v1/ogc"


def ask(client, path, status=200, **query):
    answer = client.get(path if path.startswith("http") else f"{ROOT}{path}", query_string=query or None)
    assert answer.status_code == status, answer.text
    if status >= 400:
        assert set(answer.json["error"]) == {"code", "message", "hint", "where"}
    return answer


def link(found, rel):
    (one,) = [link for link in found["links"] if link["rel"] == rel]
    return one


def ids(found):
    return [feature["id"] for feature in found["features"]]


def test_the_landing_page_leads_everywhere(client, park):
    answer = ask(client, "")
    assert answer.content_type.startswith("application/json")
    for rel, kind in (("self", "application/json"), ("conformance", "application/json"),
                      ("data", "application/json"), ("service-doc", "text/html")):  # fmt: skip
        found = link(answer.json, rel)
        assert found["type"] == kind
        assert re.match("http://", found["href"])
        assert client.get(found["href"]).status_code == 200
    api = link(answer.json, "service-desc")
    assert api["type"].startswith("application/vnd.oai.openapi+json")
    assert f"{ROOT}/collections/{{collection}}/items" in client.get(api["href"]).json["paths"]
    assert ask(client, "/").json == answer.json | {"links": answer.json["links"]}


def test_what_is_implemented_is_said(client):
    found = ask(client, "/conformance").json["conformsTo"]
    spec = "http://www.opengis.net/spec"
    assert found == [
        f"{spec}/ogcapi-features-1/1.0/conf/core",
        f"{spec}/ogcapi-features-1/1.0/conf/geojson",
        f"{spec}/ogcapi-features-3/1.0/conf/queryables",
        f"{spec}/ogcapi-features-3/1.0/conf/filter",
        f"{spec}/ogcapi-features-3/1.0/conf/features-filter",
        f"{spec}/cql2/1.0/conf/cql2-text",
        f"{spec}/cql2/1.0/conf/basic-cql2",
    ]


def test_collections_are_listed_and_described(client, park, search):
    found = ask(client, "/collections").json
    assert link(found, "self")["href"].endswith(f"{ROOT}/collections")
    by_id = {one["id"]: one for one in found["collections"]}
    assert set(by_id) == {f"{park}-photos", f"{park}-notes", f"{search}-tracks", f"{search}-objects"}
    for id_, one in by_id.items():
        assert one["title"] and one["itemType"] == "feature"
        assert one["crs"] == ["http://www.opengis.net/def/crs/OGC/1.3/CRS84"]
        assert link(one, "items")["type"] == "application/geo+json"
        assert ask(client, link(one, "self")["href"]).json == one, id_
        assert ask(client, link(one, "items")["href"]).content_type == "application/geo+json"
    (box,) = by_id[f"{park}-photos"]["extent"]["spatial"]["bbox"]
    assert box == pytest.approx([14.0, 49.9976, 14.0032, 50.0])
    (span,) = by_id[f"{search}-tracks"]["extent"]["temporal"]["interval"]
    assert span == ["2024-05-01T12:00:00.000000Z", "2024-05-01T13:00:01.000000Z"]
    assert "extent" not in by_id[f"{search}-objects"]


def test_photos_are_features_with_their_facts(client, park):
    found = ask(client, f"/collections/{park}-photos/items").json
    assert (found["type"], found["numberMatched"], found["numberReturned"]) == ("FeatureCollection", 5, 5)
    assert datetime.fromisoformat(found["timeStamp"]).tzinfo is not None
    first = found["features"][0]
    assert (first["type"], first["id"], first["geometry"]["type"]) == ("Feature", 0, "Point")
    assert first["geometry"]["coordinates"] == pytest.approx([14.000005, 49.9998])
    properties = first["properties"]
    assert (properties["name"], properties["heading_deg"], properties["radius_m"]) == ("0.jpg", 90.0, None)
    with client.get(properties["picture"]) as picture:
        assert picture.content_type == "image/jpeg"
    one = ask(client, f"/collections/{park}-photos/items/0")
    assert one.content_type == "application/geo+json"
    assert link(one.json, "self")["href"].endswith(f"/collections/{park}-photos/items/0")
    assert link(one.json, "collection")["href"].endswith(f"/collections/{park}-photos")
    assert {name: one.json[name] for name in first} == first


@pytest.mark.parametrize("which", ["photos", "notes", "tracks", "objects"])
def test_pages_lead_through_all_features_once(client, park, search, which):
    collection = f"{park if which in ('photos', 'notes') else search}-{which}"
    whole = ask(client, f"/collections/{collection}/items").json
    assert [one["rel"] for one in whole["links"]] == ["self", "collection"]
    seen, address = [], f"/collections/{collection}/items?limit=1&f=json"
    while address:
        page = ask(client, address).json
        assert (page["numberReturned"], page["numberMatched"]) == (1, whole["numberMatched"])
        assert link(page, "self")["type"] == "application/geo+json"
        seen += page["features"]
        address = next((one["href"] for one in page["links"] if one["rel"] == "next"), None)
        assert address is None or ("limit=1" in address and "f=json" in address)
    assert [one["id"] for one in seen] == ids(whole)


@pytest.mark.parametrize(
    ("which", "query", "wanted"),
    [
        ("photos", {"bbox": "14.0,49.9,14.00015,50.1"}, [0, 1]),
        ("photos", {"bbox": "14.0,49.9,0,14.00015,50.1,900"}, [0, 1]),
        ("photos", {"bbox": "14.0,60,15,61"}, []),
        ("photos", {"bbox": "14.00025,49,14.00001,50"}, [1 - 1, 3, 4]),
        ("photos", {"bbox": "-400,-90,400,90"}, [0, 1, 2, 3, 4]),
        ("photos", {"datetime": "2026-05-02T10:00:00Z"}, [1, 4]),
        ("photos", {"datetime": "2026-05-03T00:00:00Z/.."}, [2, 3, 4]),
        ("photos", {"datetime": "/2026-05-01T12:00:00+02:00"}, [0, 4]),
        (
            "photos",
            {"datetime": "2026-05-02T00:00:00Z/2026-05-03T00:00:00Z", "bbox": "14,49,14.00015,50"},
            [1],
        ),
        ("notes", {"bbox": "14.1,49,15,50"}, ["note-2"]),
        ("tracks", {"bbox": "13,49,15,51"}, [0]),
        ("tracks", {"bbox": "179,-1,-179,1"}, [1]),
        ("tracks", {"datetime": "../2024-05-01T12:30:00Z"}, [0]),
        ("tracks", {"datetime": "2024-05-01T13:00:00.5Z"}, [1]),
        ("objects", {"bbox": "13,50.5,15,51.5"}, ["b/1 ü"]),
        ("objects", {"bbox": "15,0,13,60"}, []),
        ("objects", {"datetime": "2024-05-01T12:00:01Z/.."}, ["b/1 ü", "c"]),
        ("objects", {"datetime": "2024-05-01T12:00:00Z", "limit": "1"}, ["a"]),
    ],
)
def test_features_are_chosen_by_area_and_time(client, park, search, which, query, wanted):
    """Those without a position or a time are in every area and at every time."""
    collection = f"{park if which in ('photos', 'notes') else search}-{which}"
    found = ask(client, f"/collections/{collection}/items", **query).json
    if which == "tracks":
        all_ids = ids(ask(client, f"/collections/{collection}/items").json)
        wanted = [all_ids[n] for n in wanted]
    assert ids(found) == wanted
    assert found["numberMatched"] == len(wanted)


@pytest.mark.parametrize(
    ("which", "query", "wanted"),
    [
        ("photos", {"filter": "id >= 1 AND NOT name = '2.jpg'"}, [1, 3, 4]),
        ("photos", {"filter": "taken_at IS NULL"}, [4]),
        ("photos", {"filter": "taken_at > TIMESTAMP('2026-05-02T10:00:00Z')"}, [2, 3]),
        ("photos", {"filter": "taken_at = DATE('2026-05-03') OR radius_m > 5"}, [2]),
        ("photos", {"filter": "heading_deg = 90", "bbox": "14.0,49.9,14.00015,50.1"}, [0, 1]),
        ("notes", {"filter": "title <> 'Bench' AND note IS NOT NULL"}, ["note-2"]),
        ("notes", {"filter": "floor = 'Ground'"}, []),
        ("tracks", {"filter": "source = 'odometry' AND poses = 2"}, [1]),
        ("tracks", {"filter": "first_time < TIMESTAMP('2024-05-01T12:30:00Z')"}, [0]),
        ("objects", {"filter": "class = 'car' AND id > 'a'", "filter-lang": "cql2-text"}, ["b/1 ü", "c"]),
        ("objects", {"filter": "id <> 'a'", "datetime": "../2024-05-01T12:00:01Z"}, ["b/1 ü"]),
    ],
)
def test_features_are_chosen_by_a_filter(client, park, search, which, query, wanted):
    collection = f"{park if which in ('photos', 'notes') else search}-{which}"
    if which == "tracks":
        all_ids = ids(ask(client, f"/collections/{collection}/items").json)
        wanted = [all_ids[n] for n in wanted]
    found = ask(client, f"/collections/{collection}/items", **query).json
    assert ids(found) == wanted
    assert found.get("numberMatched", len(wanted)) == found["numberReturned"] == len(wanted)
    seen, address = [], f"/collections/{collection}/items"
    given = {**query, "limit": "1"}
    while address:
        page = ask(client, address, **given).json
        seen += ids(page)
        address, given = next((one["href"] for one in page["links"] if one["rel"] == "next"), None), {}
    assert seen == wanted


def test_the_queryables_are_those_of_filters_and_features(client, park, search):
    for collection in (f"{park}-photos", f"{park}-notes", f"{search}-tracks", f"{search}-objects"):
        address = link(
            ask(client, f"/collections/{collection}").json,
            "http://www.opengis.net/def/rel/ogc/1.0/queryables",
        )
        assert address["type"] == "application/schema+json"
        answer = ask(client, address["href"])
        assert answer.content_type == "application/schema+json"
        schema = answer.json
        assert (schema["$id"], schema["type"]) == (address["href"], "object")
        features = ask(client, f"/collections/{collection}/items").json["features"]
        known = {"id", "floor", "level"}.union(*(one["properties"] for one in features))
        assert set(schema["properties"]) <= known
        nothing = " AND ".join(f"{name} IS NULL" for name in schema["properties"])
        assert ask(client, f"/collections/{collection}/items", filter=nothing).json["features"] == []


def test_a_wrong_filter_is_refused_with_its_place(client, park):
    answer = ask(client, f"/collections/{park}-photos/items", 400, filter="heading_deg < 'north'")
    assert answer.json["error"]["where"] == "filter, character 15"
    answer = ask(client, f"/collections/{park}-photos/items", 400, filter="password = 'x'")
    assert "heading_deg" in answer.json["error"]["hint"]


def test_looking_for_features_has_a_limit_of_time(client, park, monkeypatch):
    monkeypatch.setattr(ogc_collections, "_FILTER_S", -1.0)
    answer = ask(client, f"/collections/{park}-photos/items", 400, filter="id < 0")
    assert (answer.json["error"]["where"], "seconds" in answer.json["error"]["message"]) == ("filter", True)


def test_tracks_are_lines_and_are_cut_at_the_180th_meridian(client, search):
    plain, cut = ask(client, f"/collections/{search}-tracks/items").json["features"]
    assert plain["geometry"] == {"type": "LineString", "coordinates": [[14.0, 50.0], [15.0, 50.0]]}
    assert plain["properties"]["first_time"] == "2024-05-01T12:00:00.000000Z"
    assert cut["geometry"]["type"] == "MultiLineString"
    assert ask(client, f"/collections/{search}-tracks/items/{cut['id']}").json["geometry"] == cut["geometry"]


def test_long_tracks_are_thinned(client, search, monkeypatch):
    monkeypatch.setattr(ogc_collections, "_MOST_POSES", 1)
    found = ask(client, f"/collections/{search}-tracks/items").json["features"]
    assert [one["properties"]["poses"] for one in found] == [2, 2]


def test_an_object_is_found_by_any_id(client, search):
    found = ask(client, f"/collections/{search}-objects/items/b%2F1%20%C3%BC").json
    assert (found["id"], found["properties"]["class"]) == ("b/1 ü", "car")
    assert ask(client, link(found, "self")["href"]).json["id"] == "b/1 ü"


@pytest.mark.parametrize(
    "query",
    ["bbox=1,2,3", "bbox=a,b,c,d", "bbox=1,9,3,4", "bbox=nan,0,1,1", "bbox=1,2,3,inf", "limit=0", "limit=-1",
     "limit=x", "limit=٣", "datetime=today", "datetime=../..", "datetime=2026-05-02/2026-05-01", "datetime=",
     "f=html", "unknown=1", "filter-lang=cql2-json", "filter-crs=EPSG:4326", "limit=1&limit=2",
     "after=" + "x" * 301],
)  # fmt: skip
def test_wrong_parameters_are_refused_by_name(client, park, query):
    answer = ask(client, f"/collections/{park}-photos/items?{query}", 400)
    assert answer.json["error"]["where"] == query.partition("=")[0]


def test_a_limit_beyond_the_largest_is_the_largest():
    assert parse_items({"limit": ["99999999"]}, {}).limit == 10_000
    with pytest.raises(UsageError):
        parse_items({"limit": ["9" * 30]}, {})


@pytest.mark.parametrize(
    "path", ["", "/conformance", "/collections", "/collections/{}", "/collections/{}/items/0"]
)
def test_unknown_parameters_are_refused_everywhere(client, park, path):
    ask(client, f"{path.format(f'{park}-photos')}?x=1", 400)


@pytest.mark.parametrize(
    "path",
    ["no", "map-no-photos", "map-park-2-tracks", "mission-1-photos", "mission-99-tracks",
     "mission-9999999999-tracks", "map--photos"],
)  # fmt: skip
def test_other_collections_do_not_exist(client, park, path):
    for more in ("", "/items", "/items/0"):
        ask(client, f"/collections/{path}{more}", 404)


@pytest.mark.parametrize("id_", ["5", "-1", "x", "99999999999999", "note-9", "track-99"])
def test_other_features_do_not_exist(client, park, search, id_):
    for collection in (f"{park}-photos", f"{park}-notes", f"{search}-tracks", f"{search}-objects"):
        ask(client, f"/collections/{collection}/items/{id_}", 404)


def test_a_map_without_a_georeference_has_features_without_geometry(client, park):
    client.delete("/api/v1/maps/park-2/georeference")
    assert ask(client, "/collections").json["collections"] == []
    found = ask(client, f"/collections/{park}-photos/items", bbox="0,0,1,1").json
    assert [one["geometry"] for one in found["features"]] == [None] * 5


def test_photos_in_the_tray_are_left_out(client, park):
    client.patch("/api/v1/maps/park-2/experiences/1", json={"x_px": None, "y_px": None})
    assert ids(ask(client, f"/collections/{park}-photos/items").json) == [0, 2, 3, 4]
    ask(client, f"/collections/{park}-photos/items/1", 404)


def test_only_who_has_a_role_sees_a_collection(
    app, client, park, search, library, new_account, sign_in, stranger
):
    eva = new_account("Eva")
    browser = sign_in(eva)
    paths = [
        f"/collections/{one}{more}"
        for one in (f"{park}-photos", f"{search}-objects")
        for more in ("", "/items")
    ]
    for path in ["", "/conformance", "/collections", *paths]:
        assert stranger.get(f"{ROOT}{path}").status_code == 401
    assert ask(browser, "/collections").json["collections"] == []
    for path in paths:
        ask(browser, path, 404)
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug="park-2").one()
        accounts.set_member_role(session, record, account=session.merge(eva), role="viewer")
        token = accounts.new_token(session, session.merge(eva), name="QGIS")
    program = app.test_client()
    headers = {"Authorization": f"Bearer {token}"}
    found = program.get(f"{ROOT}/collections", headers=headers).json["collections"]
    assert {one["id"] for one in found} == {f"{park}-photos", f"{park}-notes"}
    assert program.get(f"{ROOT}/collections/{park}-photos/items", headers=headers).json["numberMatched"] == 5
    client.delete("/api/v1/maps/park-2")
    assert program.get(f"{ROOT}/collections", headers=headers).json["collections"] == []
    assert program.get(f"{ROOT}/collections/{park}-photos/items", headers=headers).status_code == 404


def test_area_and_time_of_points_without_them():
    query = parse_items({"bbox": ["170,-10,-170,10"], "datetime": ["2026-05-01T00:00:00Z"]}, {})
    np.testing.assert_array_equal(query.within([0, 0, 0, np.nan], [175, -175, 0, np.nan]), [1, 1, 0, 1])
    assert query.during(None, None)
    assert not query.during(0.0, 1.0)
