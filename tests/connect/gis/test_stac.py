"""STAC API: read by pystac-client, checked against the schemas of STAC, and who sees what."""

import json
import threading

import jsonschema
import numpy as np
import pystac
import pystac_client
import pytest
import requests
from pystac.validation.local_validator import get_local_schema_cache
from referencing import Registry, Resource
from werkzeug.serving import WSGIRequestHandler, make_server

from tests.web.sharing.stripes import BOX, blur
from webapp.connect.gis.stac_items import _last_page
from webapp.connect.gis.stac_regions import MOST_CORNERS, parse_region
from webapp.errors import UsageError
from webapp.net.street import Panoramax
from webapp.store.accounts import accounts
from webapp.store.schema import MapRecord, Photo

ROOT = "/api/v1/stac"
SQUARE = [[[14.0, 49.9], [14.00015, 49.9], [14.00015, 50.1], [14.0, 50.1], [14.0, 49.9]]]


def ask(client, path, status=200, **query):
    answer = client.get(path if path.startswith("http") else f"{ROOT}{path}", query_string=query or None)
    assert answer.status_code == status, answer.text
    if status >= 400:
        assert set(answer.json["error"]) == {"code", "message", "hint", "where"}
    return answer


def ids(found):
    return [feature["id"] for feature in found["features"]]


def errors(kind, document):
    """Return how a document differs from a schema of STAC, which pystac has in files."""
    schemas = get_local_schema_cache()
    registry = Registry().with_resources(
        [(address, Resource.from_contents(one)) for address, one in schemas.items()]
    )
    (wanted,) = [
        one for address, one in schemas.items() if address.endswith(f"/{kind}.json") and "stacspec" in address
    ]
    return [
        one.message for one in jsonschema.Draft7Validator(wanted, registry=registry).iter_errors(document)
    ]


class Quiet(WSGIRequestHandler):
    def log(self, *_):
        pass


@pytest.fixture
def catalog(app, library, owner, park):
    """The server as pystac-client sees it, signed in by a token."""
    with library.database.write() as session:
        token = accounts.new_token(session, session.merge(owner), name="STAC")
    server = make_server("127.0.0.1", 0, app, threaded=True, request_handler=Quiet)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    headers = {"Authorization": f"Bearer {token}"}
    client = pystac_client.Client.open(f"http://127.0.0.1:{server.server_port}{ROOT}", headers=headers)
    client.token_headers = headers
    yield client
    client._stac_io.session.close()
    server.shutdown()
    server.server_close()
    thread.join()


def test_pystac_client_finds_maps_and_photos(catalog):
    assert catalog.conforms_to("ITEM_SEARCH") and catalog.conforms_to("COLLECTIONS")
    (found,) = catalog.get_collections()
    assert (found.id, found.license, found.providers[0].roles) == ("park-2", "other", ["host"])
    assert found.extent.temporal.to_dict() == {"interval": [["2026-05-01T10:00:00Z", "2026-05-04T10:00:00Z"]]}
    west, south, east, north = found.extent.spatial.bboxes[0]
    assert [item.id for item in found.get_items()] == [f"park-2-{n}" for n in range(5)]
    item = found.get_item("park-2-1")
    assert west <= item.geometry["coordinates"][0] <= east
    assert south <= item.geometry["coordinates"][1] <= north
    assert item.geometry["coordinates"] == pytest.approx([14.000105, 49.9998])
    assert item.datetime.isoformat() == "2026-05-02T10:00:00+00:00"
    assert item.properties["view:azimuth"] == 90.0
    for name, kind in (("thumb", "image/webp"), ("sd", "image/jpeg"), ("hd", "image/jpeg")):
        asset = item.assets[name]
        answer = requests.get(asset.href, headers=catalog.token_headers, timeout=10)
        assert (answer.status_code, answer.headers["Content-Type"], asset.media_type) == (200, kind, kind)
        assert requests.get(asset.href, timeout=10).status_code == 401
    assert item.get_collection().id == "park-2"


SEARCHES = [
    ({}, [0, 1, 2, 3, 4]),
    ({"bbox": [14.0, 49.9, 14.00015, 50.1]}, [0, 1]),
    ({"intersects": {"type": "Polygon", "coordinates": SQUARE}}, [0, 1]),
    ({"datetime": "2026-05-03T00:00:00Z/.."}, [2, 3, 4]),
    ({"ids": ["park-2-3", "park-2-0", "park-2-77", "other-1", "x"]}, [0, 3]),
    ({"collections": ["park-2", "none"], "bbox": [14.0, 49.9, 14.00015, 50.1]}, [0, 1]),
    ({"collections": ["none"]}, []),
]


def test_pystac_client_searches_in_pages(catalog):
    for query, wanted in SEARCHES:
        for method in ("GET", "POST"):
            found = catalog.search(method=method, limit=2, **query)
            assert [item.id for item in found.items()] == [f"park-2-{n}" for n in wanted], (method, query)


def links_of(found):
    return {link["rel"]: link for link in found["links"]}


@pytest.mark.parametrize(
    ("method", "path"), [("GET", "/search"), ("POST", "/search"), ("GET", "/collections/park-2/items")]
)
def test_pages_lead_forwards_and_back(client, park, method, path):
    def follow(link):
        assert link["method"] == method
        if method == "GET":
            return ask(client, link["href"]).json
        answer = client.post(link["href"], json=link["body"])
        assert answer.status_code == 200, answer.text
        return answer.json

    body = {"limit": 2, "collections": ["park-2"]}
    if method == "POST":
        page = client.post(f"{ROOT}{path}", json=body).json
    else:
        page = ask(client, path, limit=2, collections="park-2").json
    seen = [ids(page)]
    assert "prev" not in links_of(page)
    while "next" in links_of(page):
        page = follow(links_of(page)["next"])
        seen.append(ids(page))
    assert seen == [["park-2-0", "park-2-1"], ["park-2-2", "park-2-3"], ["park-2-4"]]
    for wanted in reversed(seen[:-1]):
        page = follow(links_of(page)["prev"])
        assert ids(page) == wanted
    assert "prev" not in links_of(page)


def test_pages_lead_back_over_maps():
    maps = [("c", np.array([4, 7])), ("b", np.array([], np.int64)), ("a", np.array([1, 2, 9]))]
    found = [_last_page(maps, limit) for limit in range(1, 7)]
    assert found == ["c-4", "a-9", "a-2", "a-1", "", ""]
    assert _last_page(maps[1:2], 3) is None


def test_photos_lead_to_those_before_and_after_by_time(catalog, client, library):
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug="park-2").one()
        session.get_one(Photo, (record.id, 3)).taken_at = "2026-04-30T12:00:00+02:00"
    collection = catalog.get_collection("park-2")
    item, way = collection.get_item("park-2-3"), []
    assert item.get_single_link("prev") is None
    while item:
        way.append(item.id)
        link = item.get_single_link("next")
        following = link and collection.get_item(link.extra_fields["id"])
        if following:
            assert link.extra_fields["geometry"] == following.geometry
            assert link.href == following.get_self_href()
            assert following.get_single_link("prev").extra_fields["id"] == item.id
        item = following
    assert way == [f"park-2-{n}" for n in (3, 0, 1, 2, 4)]  # the last has no time


def test_everything_matches_the_schemas_of_stac(client, park):
    landing = ask(client, "").json
    assert errors("catalog", landing) == []
    (found,) = ask(client, "/collections").json["collections"]
    assert errors("collection", found) == []
    assert ask(client, "/collections/park-2").json == found
    pystac.Collection.from_dict(found)
    answer = ask(client, "/collections/park-2/items")
    assert answer.content_type == "application/geo+json"
    items = answer.json["features"]
    assert [error for one in items for error in errors("item", one)] == []
    assert ask(client, "/collections/park-2/items/park-2-0").json == items[0]
    assert answer.json["numberMatched"] == ask(client, "/search").json["numberMatched"] == 5


def test_a_photo_without_a_time_has_the_span_in_which_it_must_be(client, park):
    found = ask(client, "/collections/park-2/items/park-2-4").json["properties"]
    assert found["datetime"] is None
    assert found["start_datetime"] < "2000" < found["end_datetime"] == found["created"]


def test_a_photo_of_a_service_has_its_licence_and_is_read_as_of_panoramax(client, park, library):
    page = "https://p.example/7"
    source = {"service": "Panoramax", "id": "7", "licence": "CC BY-SA 4.0", "author": "Ana", "url": page}
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug="park-2").one()
        photo = session.get_one(Photo, (record.id, 0))
        photo.source, photo.fov_deg, photo.camera = source, 360.0, "Maker One"
    item = ask(client, "/collections/park-2/items/park-2-0").json
    facts = item["properties"]
    assert (facts["license"], facts["geovisio:producer"]) == ("CC-BY-SA-4.0", "Ana")
    assert facts["providers"] == [{"name": "Ana", "roles": ["producer"], "url": page}]
    camera = facts["pers:interior_orientation"]
    assert (camera["field_of_view"], camera["camera_model"]) == (360.0, "Maker One")
    read = Panoramax("https://maps.example.org").photo(item)
    assert (read.heading_deg, read.licence, read.author) == (90.0, "CC-BY-SA-4.0", "Ana")
    assert read.address == item["assets"]["hd"]["href"]


def test_the_original_of_a_blurred_photo_is_no_asset(client, park):
    assert set(ask(client, "/collections/park-2/items/park-2-0").json["assets"]) == {"thumb", "sd", "hd"}
    assert blur(client, "park-2", BOX).status_code == 200
    assert set(ask(client, "/collections/park-2/items/park-2-0").json["assets"]) == {"thumb", "sd"}


def test_wrong_parameters_are_refused_by_name(client, park):
    for query in (
        "bbox=1,2,3", "limit=0", "datetime=today", "unknown=1", "filter=a", "f=html", "intersects={",
        "intersects=1", 'intersects={"type":"Polygon","coordinates":[]}',
        'intersects={"type":"Point","coordinates":["a",1]}',
        'intersects={"type":"Point","coordinates":[1,2]}&bbox=1,2,3,4', "ids=" + "a," * 101,
    ):  # fmt: skip
        for path in ("/search", "/collections/park-2/items"):
            answer = ask(client, f"{path}?{query}", 400)
            assert answer.json["error"]["where"] == query.partition("=")[0]


def test_wrong_bodies_are_refused(client, park):
    for body in (
        {"limit": 0},
        {"bbox": [1, 2, 3]},
        {"bbox": [1, 9, 3, 4]},
        {"intersects": {"type": "Circle"}},
    ):
        answer = client.post(f"{ROOT}/search", json=body)
        assert answer.status_code in (400, 422), answer.text
        assert next(iter(body)) in answer.text


def test_other_addresses_do_not_exist(client, park):
    for path in (
        "none",
        "none/items",
        *(f"park-2/items/{id}" for id in ("park-2-9", "0", "other-0", "park-2-99999999999")),
    ):
        ask(client, f"/collections/{path}", 404)


def test_a_map_without_a_georeference_is_no_collection(client, park):
    client.delete("/api/v1/maps/park-2/georeference")
    assert ask(client, "/collections").json["collections"] == []
    assert "georeference" in ask(client, "/collections/park-2/items", 404).json["error"]["message"]
    assert ids(ask(client, "/search").json) == []


def test_only_who_has_a_role_sees_a_map(client, park, new_account, sign_in, stranger):
    browser = sign_in(new_account("Eva"))
    paths = ["/collections/park-2", "/collections/park-2/items", "/collections/park-2/items/park-2-0"]
    for path in ["", "/conformance", "/collections", "/search", *paths]:
        assert stranger.get(f"{ROOT}{path}").status_code == 401
    assert ids(ask(browser, "/search", ids="park-2-0").json) == ids(ask(browser, "/search").json) == []
    assert [link["rel"] for link in ask(browser, "").json["links"]].count("child") == 0
    for path in paths:
        ask(browser, path, 404)


@pytest.mark.parametrize(
    ("geometry", "wanted"),
    [
        ({"type": "Point", "coordinates": [1.0, 1.0]}, "a"),
        ({"type": "MultiPoint", "coordinates": [[1.0, 1.0], [9.0, 9.0, 5.0]]}, "a"),
        ({"type": "LineString", "coordinates": [[0.0, 0.0], [3.0, 3.0]]}, "ab"),
        ({"type": "MultiLineString", "coordinates": [[[0, 0], [0, 9]], [[2, 2], [2, 3]]]}, "b"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]]}, "ab"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]],
                                             [[1.5, 1.5], [1.5, 3], [3, 3], [3, 1.5], [1.5, 1.5]]]}, "a"),
        ({"type": "MultiPolygon", "coordinates": [[[[4, 5], [6, 5], [5, 7], [4, 5]]]]}, "c"),
        ({"type": "GeometryCollection", "geometries": [{"type": "Point", "coordinates": [5, 6]}]}, "c"),
    ],
)  # fmt: skip
def test_regions_have_points(geometry, wanted):
    lat, lon = np.array([[1.0, 1.0], [2.0, 2.0], [6.0, 5.0]]).T
    assert "".join(np.array([*"abc"])[parse_region(geometry)(lat, lon)]) == wanted


def test_a_geometry_has_limits():
    many = [[0.0, 0.0]] * (MOST_CORNERS + 1)
    deep = {"type": "Point", "coordinates": [0, 0]}
    for _ in range(4):
        deep = {"type": "GeometryCollection", "geometries": [deep]}
    for geometry in ({"type": "LineString", "coordinates": many}, deep,
                     {"type": "MultiPoint", "coordinates": many},
                     {"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}, [], json.loads("NaN"),
                     {"type": "Point", "coordinates": [True, 1]}):  # fmt: skip
        with pytest.raises(UsageError):
            parse_region(geometry)
