"""The JSON of requests is limited before it is parsed, and the caller's right is checked before that."""

import io
import json

import pytest
from apiflask import Schema, fields

from webapp.missions.store import missions, tracks
from webapp.settings import Settings, WebSettings
from webapp.store.accounts import accounts
from webapp.store.photo_libraries import LinkedAlbum, PhotoLibrary
from webapp.store.schema import MapRecord
from webapp.tasks.maps import adopt_map
from webapp.web import json_bodies
from webapp.web.context import checked_right
from webapp.web.fields import BoundedDict, BoundedList
from webapp.web.json_bodies import limits_of, longest

JSON = {"Content-Type": "application/json"}
LEVELS, DIGITS = 100_000, 4301
REFUSED = {400, 413, 422}
NO_RIGHT_NEEDED = {
    "api_account.change",
    "api_account.new_token",
    "api_account_events.add",
    "api_exchange.import_zip",
    "api_find.find",
    "api_missions.create",
    "api_photo_libraries.connect",
    "api_staged.begin",
    "api_stac.search_by_body",
    "maps.create",
}
"""Routes with a body that every account may use."""


@pytest.fixture
def settings(tmp_path, database_url):
    return Settings(
        library=tmp_path / "library", database=database_url, web=WebSettings(requests_per_minute=10**6)
    )


@pytest.fixture(autouse=True)
def not_in_anger(app):
    """Turn errors of the program into responses, as on the server, instead of raising them."""
    app.testing = False


def rules_with_body(app):
    """Return each route of the API that takes a body, as (rule, method, schema, media type)."""
    found = []
    for rule in app.url_map.iter_rules():
        spec = getattr(app.view_functions[rule.endpoint], "_spec", {})
        if spec.get("body") is not None:
            (method,) = rule.methods - {"HEAD", "OPTIONS"}
            found.append((rule, method, spec["body"], spec["content_type"]))
    assert len(found) > 50
    return found


def input_schemas(app):
    """Return the schema of each input: of bodies, query strings and headers."""
    found = [schema for _, _, schema, _ in rules_with_body(app)]
    for view in app.view_functions.values():
        found += [schema for schema, _ in getattr(view, "_spec", {}).get("args") or []]
    return found


@pytest.fixture
def token_of(library):
    """Make a token for an account."""

    def make(account):
        with library.database.write() as session:
            return accounts.new_token(session, session.merge(account), name="test")

    return make


@pytest.fixture
def authorization(token_of, owner):
    """Headers of JSON from the owner."""
    return {"Authorization": f"Bearer {token_of(owner)}", **JSON}


@pytest.fixture
def addresses(app, library, owner, client, park):
    """The URL of each route with a body, on an existing map and mission, by endpoint."""
    with library.database.write() as session:
        map_id = session.query(MapRecord).filter_by(slug=park).one().id
        mission = missions.create(session, "Round", account_id=owner.id, map_id=map_id)
        albums = PhotoLibrary(
            account_id=owner.id, kind="immich", address="https://immich.example", sealed_key=""
        )
        session.add(albums)
        session.flush()
        of_album = {"album": "a", "name": "A", "every_h": 0, "writes_back": False}
        linked = LinkedAlbum(library_id=albums.id, map_id=map_id, **of_album)
        session.add(linked)
        session.flush()
        in_library = {"api_photo_libraries.link": albums.id, "api_photo_libraries.change_linked": linked.id}
        mission_id, track_id = mission.id, tracks.get_or_create(session, mission.id, source="gps", name="").id
    file_id = client.post("/api/v1/mission-files", json={"name": "a.gpx", "size_bytes": 9}).json["id"]
    token = client.post(f"/api/v1/maps/{park}/shares", json={"localize": True}).json["url"].split("/")[-1]
    phone = (
        client.post(f"/api/v1/missions/{mission_id}/phones", json={"name": "A"}).json["url"].split("/")[-1]
    )
    shape = {"kind": "marker", "name": "A", "points": [[50.0, 14.0]]}
    drawing = client.post(f"/api/v1/missions/{mission_id}/drawings", json=shape).json["id"]
    hook = {"kind": "webhook", "address": "https://example.org/hook", "events": []}
    receiver = client.post("/api/v1/account/events", json=hook).json["id"]
    values = {"slug": park, "mission_id": mission_id, "file_id": file_id, "token": token}
    values |= {"id": 1, "name": "a", "object_id": "a", "drawing_id": drawing, "track_id": track_id}
    adapter = app.url_map.bind("")
    found = {}
    for rule, method, _, _ in rules_with_body(app):
        tokens = {"token": phone} if rule.endpoint.startswith("api_phone_positions") else {}
        own = {"id": receiver} if rule.endpoint.startswith("api_account_events") else {}
        own |= {"id": in_library[rule.endpoint]} if rule.endpoint in in_library else {}
        given = {name: (values | tokens | own)[name] for name in rule.arguments}
        found[rule.endpoint] = adapter.build(rule.endpoint, given, method=method)
    return found


def long_lists(schema):
    """Return objects in which one list or dictionary is longer than its field allows; nested ones, too."""
    for name, field in schema.load_fields.items():
        key = field.data_key or name
        if isinstance(field, BoundedList):
            yield {key: [1] * (field.most + 1)}
            yield {key: [{}] * (field.most + 1)}
            if isinstance(field.inner, fields.Nested):
                yield from ({key: [inner]} for inner in long_lists(field.inner.schema))
        elif isinstance(field, BoundedDict):
            yield {key: {str(n): [1, 1] for n in range(field.most + 1)}}
        elif isinstance(field, fields.Nested):
            yield from ({key: inner} for inner in long_lists(field.schema))


FOR_ALL = {
    "deep lists": b"[" * LEVELS,
    "deep objects": b'{"a":' * LEVELS + b"1" + b"}" * LEVELS,
    "many digits": b'{"name":' + b"9" * DIGITS + b"}",
    "numbers": b"[1" + b",1" * 500_000 + b"]",
}
"""Bodies that are sent to every route, by name."""

FOR_ONE = {
    "deep lists that end": b"[" * 50 + b"]" * 50,
    "many decimals": b'{"name":1.' + b"9" * DIGITS + b"}",
    "not a number": b'{"name":NaN}',
    "infinite": b'{"name":-Infinity}',
    "large exponent": b'{"name":1e999999999}',
    "half a surrogate": b'{"name":"\\ud800"}',
    "name with half a surrogate": b'{"\\udc00":1}',
    "twice": b'{"name":"a","name":"b"}',
    "not UTF-8": b'{"name":"\xff"}',
    "no end": b'{"name":"' + b'\\"' * 1000,
    "unknown fields": b"{" + b",".join(b'"%d":1' % n for n in range(90)) + b"}",
    "nothing": b" ",
    "a number": b"1",
}
"""Bodies that are sent to one route, by name."""


def test_every_text_list_and_dictionary_of_a_request_has_a_maximum_length(app):
    unlimited = []

    def check(field, path):
        if isinstance(field, fields.Nested):
            walk(field.schema, path)
        elif isinstance(field, fields.List):
            unlimited.extend([] if isinstance(field, BoundedList) else [path])
            check(field.inner, f"{path}[]")
        elif isinstance(field, fields.Dict):
            unlimited.extend([] if isinstance(field, BoundedDict) else [path])
        elif type(field) is fields.Raw:
            unlimited.append(path)
        elif isinstance(field, fields.String):
            try:
                longest(field.validators)
            except TypeError:
                unlimited.append(path)

    def walk(schema, path):
        for name, field in schema.load_fields.items():
            check(field, f"{path}.{name}")

    for schema in input_schemas(app):
        walk(schema, type(schema).__name__)
    assert unlimited == []


def test_the_limits_of_a_route_follow_from_its_schema(app):
    limits = {
        rule.endpoint: limits_of(schema)
        for rule, _, schema, kind in rules_with_body(app)
        if kind == "application/json"
    }
    assert len(limits) > 40
    assert limits["api_shares.create"].bytes < 10_000
    assert limits["maps.create"].bytes < 20_000
    assert limits["maps.remove_many"].values < 11_000
    large = {name for name, one in limits.items() if one.bytes > 500_000}
    assert large == {
        "api_batches.send",
        "api_landmarks.accept",
        "api_landmarks.correct",
        "api_placements.put",
        "api_staged.import_staged",
        "api_uploads.begin",
        "maps.edit_many",
    }


def test_hostile_json_is_refused_by_every_route(app, addresses, authorization):
    client, wrong = app.test_client(), []
    for rule, method, schema, kind in rules_with_body(app):
        if kind != "application/json":
            continue
        long = {f"long {n}": json.dumps(body).encode() for n, body in enumerate(long_lists(schema))}
        for name, body in (FOR_ALL | long).items():
            answer = client.open(addresses[rule.endpoint], method=method, data=body, headers=authorization)
            shape = set(answer.json.get("error", {}))
            if answer.status_code not in REFUSED or shape != {"code", "message", "hint", "where"}:
                wrong.append((rule.endpoint, name, answer.status_code))
    assert wrong == []


@pytest.mark.parametrize("name", FOR_ONE)
def test_invalid_json_is_explained(client, name):
    answer = client.patch("/api/v1/account", data=FOR_ONE[name], headers=JSON)
    assert answer.status_code in (400, 422)
    assert answer.json["error"]["message"] and answer.json["error"]["where"]


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b'{"changes":[' + b"{}," * 5_000_000 + b"{}]}", 413),
        (b'{"changes":"' + b"a" * 16_000_000 + b'"}', 413),
        (b'{"changes":' + b"[" * 30 + b"]" * 30 + b"}", 400),
        (b'{"changes":[{"id":' + b"1" * 101 + b"}]}", 400),
    ],
)
def test_what_exceeds_the_limits_is_not_parsed(client, park, monkeypatch, body, status):
    def parse(data, where):
        raise AssertionError("parsed")

    monkeypatch.setattr(json_bodies, "parse_json", parse)
    answer = client.patch(f"/api/v1/maps/{park}/experiences", data=body, headers=JSON)
    assert answer.status_code == status


def test_a_long_list_is_refused_before_its_items_are_converted():
    class Item(fields.Integer):
        def _deserialize(self, *args, **options):
            raise AssertionError("converted")

    for field, value in (
        (BoundedList(Item(), most=3), [1] * 4),
        (BoundedDict(keys=Item(), values=Item(), most=3), dict.fromkeys("abcd", 1)),
    ):
        errors = Schema.from_dict({"given": field})().validate({"given": value})
        assert errors == {"given": ["Longer than maximum length 3."]}


def test_a_large_edit_is_accepted(client, library, owner, make_map):
    make_map(library.map_folder("wood"), 3)
    adopt_map.adopt_map(library, "wood", account_id=owner.id)
    note = 'a, [b] {c} "d" \U0001f600' * 40
    change = {"x_px": 1.5, "y_px": 2.5, "heading_deg": 359.125, "note": note}
    changes = [{"id": n % 3, **change} for n in range(10_000)]
    body = json.dumps({"changes": changes}, indent=1)
    assert len(body) > 9_000_000
    answer = client.patch("/api/v1/maps/wood/experiences", data=body, headers=JSON)
    assert answer.status_code == 200, answer.text
    assert answer.json["photos"][0]["note"] == note


class Unread(io.BytesIO):
    """A body that notes whether it was read."""

    was_read = False

    def read(self, size=-1):
        self.was_read = True
        return super().read(size)

    def readinto(self, buffer):
        self.was_read = True
        return super().readinto(buffer)


def test_no_body_is_read_before_the_right_of_the_caller_is_checked(
    app, library, addresses, park, new_account, token_of
):
    viewer, other = new_account("Vera"), new_account("Mallory")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=park).one()
        accounts.set_member_role(session, record, account=session.merge(viewer), role="viewer")
    callers = {
        "nobody": {},
        "viewer": {"Authorization": f"Bearer {token_of(viewer)}"},
        "other": {"Authorization": f"Bearer {token_of(other)}"},
    }
    client, read = app.test_client(), {name: set() for name in callers}
    for rule, method, _, kind in rules_with_body(app):
        for name, caller in callers.items():
            body, address = Unread(b"{[" * 50), addresses[rule.endpoint]
            if "token" in rule.arguments:
                address = address.replace(address.split("/")[4], "wrong")
            headers = {"Content-Type": f"{kind}; boundary=x", **caller}
            answer = client.open(address, method=method, input_stream=body, headers=headers)
            if body.was_read:
                read[name].add(rule.endpoint)
            else:
                expected = {"nobody": {401, 404}, "viewer": {403, 404}, "other": {403, 404}}[name]
                assert answer.status_code in expected, (rule.endpoint, name, answer.text)
    for_viewers = {"api_localize.localize", "api_exchange.export_by_job", "api_exchange.duplicate"}
    assert read == {"nobody": set(), "viewer": NO_RIGHT_NEEDED | for_viewers, "other": NO_RIGHT_NEEDED}


def test_every_route_with_a_body_states_the_right_that_it_needs(app):
    """Those about accounts are checked for the whole blueprint, `find` also while its answer is streamed."""
    unchecked = {
        rule.endpoint
        for rule, _, _, _ in rules_with_body(app)
        if checked_right(app.view_functions[rule.endpoint]) is None
    }
    assert unchecked == NO_RIGHT_NEEDED - {"api_find.find"} | {"api_people.add"}
