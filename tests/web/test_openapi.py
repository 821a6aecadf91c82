"""The OpenAPI document is complete; responses to any request match it and respect permissions."""

import io
import itertools
import json
import re
from concurrent.futures import ThreadPoolExecutor

import hypothesis
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given
from hypothesis import strategies as st
from PIL import Image
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission, MissionPhoto
from webapp.missions.tasks import add_photo, store_batch
from webapp.missions.tasks.add_photo import PhotoMetadata
from webapp.missions.tasks.store_batch import Numbered
from webapp.settings import MissionSettings, Settings
from webapp.store import queries
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.outbox import EventReceiver
from webapp.store.schema import MapRecord, Photo, QueryRecord
from webapp.tasks.maps import adopt_map
from webapp.web.maps.schemas import MapChanges, MapState
from webapp.web.openapi import PATH

# schemathesis does not close answers that are files
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

PLAIN = {"Accept-Encoding": "identity"}
"""Schemathesis requests compressed responses from the application, but cannot decompress them."""

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
GEO = {
    "format": "experience-map",
    "version": 1,
    "georeference": {
        "plane": "EPSG:4326",
        "plane_from_pixel": [[1e-5, 0, 26.5], [0, -1e-5, 60.4], [0, 0, 1]],
        "method": "corners",
    },
}
OF_THE_MAP = re.compile("{slug}|{mission_id}")
HOSTILE = ["..", "a\x00b", "%2e%2e", "map.cfg", "' OR 1=1 --", "\u202e", "é" * 300, "C:\\x"]
NUMBERS = [0, 1, 10**4, 2**31 - 1, 2**31, 2**63 - 1, 2**63, 10**40]


@pytest.fixture
def settings(tmp_path):
    """Settings with which event streams end at once."""
    return Settings(library=tmp_path / "library", missions=MissionSettings(stream_s=0.0))


@pytest.fixture(autouse=True)
def not_in_anger(app):
    """Turn errors of the program into responses, as on the server, instead of raising them."""
    app.testing = False


@pytest.fixture
def document(app):
    return app.test_client().get(PATH).json


@pytest.fixture
def api(document, app):
    schema = schemathesis.openapi.from_dict(document)
    schema.app = app
    return schema


@pytest.fixture
def operations(api):
    found = [result.ok() for result in api.get_all_operations()]
    assert len(found) > 50
    return found


def picture():
    """Return a JPEG file."""
    file = io.BytesIO()
    Image.new("RGB", (40, 30)).save(file, "JPEG")
    return file.getvalue()


@pytest.fixture
def add_mission(library, settings, owner):
    """Make a mission on a map with a track, an object and a photo, and return their ids by parameter."""

    def make(map_id):
        with library.database.write() as session:
            id = missions.create(session, "Round", account_id=owner.id, map_id=map_id).id
        spot = {"time": 1.0, "lat": 60.4, "lon": 26.5}
        records = [{"type": "pose", **spot}, {"type": "object", "id": "car-1", "class": "car", **spot}]
        store_batch.store_batch(library, id, records=records, place=Numbered("robot", 0))
        (library.uploads / "m.part").write_bytes(picture())
        photo = add_photo.add_mission_photo(
            library,
            id,
            source=library.uploads / "m.part",
            name="m.jpg",
            about=PhotoMetadata(object_id="car-1"),
            settings=settings,
        )
        with library.database.read() as session:
            (track,) = tracks.list_tracks(session, id)
        return {
            "mission_id": [id],
            "track_id": [track.id],
            "object_id": ["car-1"],
            "sha256": [photo.sha256],
        }

    return make


@pytest.fixture
def fresh(library, owner, make_map, add_mission):
    """Make a map with photos, a placement, a query, an upload, a job, a mission; return its slug and ids."""
    numbers = itertools.count()

    def make():
        slug = f"park-{next(numbers)}"
        cfg = make_map(library.map_folder(slug), 2)
        cfg.with_name("map.json").write_text(json.dumps(GEO))
        map_id = adopt_map.adopt_map(library, slug, account_id=owner.id)
        with library.database.write() as session:
            record = session.get_one(MapRecord, map_id)
            row = QueryRecord(
                name="q.jpg",
                file="0.jpg",
                width=4,
                height=3,
                options={},
                answer={"hypotheses": []},
                evidence=[],
            )
            queries.add(session, record, row=row, most=10)
            file = maps.Announced("a.jpg", 10, "f")
            upload = maps.begin_upload(session, record, account_id=owner.id, file=file)
            job = jobs.enqueue(session, "health", map_id=map_id, account_id=owner.id)
            session.flush()
            photos = [0, 1]
            ids = {"photos": photos, "experiences": photos, "queries": [row.id], "uploads": [upload.id]}
            hook = {"kind": "webhook", "address": "https://example.org/", "events": [], "salt": "0"}
            receiver = EventReceiver(account_id=owner.id, **hook)
            session.add(receiver)
            session.flush()
            ids |= {"events": [receiver.id]}
            ids |= {"jobs": [job.id], "placements": ["other"], "members": [owner.id], "accounts": [owner.id]}
        ids |= add_mission(map_id)
        ids["feature"] = [f"{slug}-0", "track-1"]
        ids["collection"] = [f"map-{slug}-photos", f"mission-{ids['mission_id'][0]}-tracks"]
        folder = queries.folder(library, map_id)
        folder.mkdir(parents=True)
        (folder / "0.jpg").write_bytes(picture())
        return slug, ids

    return make


@pytest.fixture
def token(library):
    """Make a token for an account."""
    numbers = itertools.count()

    def make(account):
        with library.database.write() as session:
            return accounts.new_token(session, session.merge(account), name=f"test {next(numbers)}")

    return make


def cases(operation, slug, ids, modes=GenerationMode):
    """Return a strategy of requests to an address of a map, valid or not; existing and impossible ids."""
    made = st.one_of(operation.as_strategy(generation_mode=mode) for mode in modes)

    @st.composite
    def addressed(draw):
        case = draw(made)
        parts = operation.path.split("/")
        for name in case.path_parameters:
            place = parts.index(f"{{{name}}}") if f"{{{name}}}" in parts else 0
            known = [slug] if name == "slug" else ids.get(name) or ids.get(parts[place - 1], [])
            wild = HOSTILE if name in ("slug", "name", "form", "object_id", "sha256") else NUMBERS
            pick = draw(st.integers(0, 9))
            if known and pick < 8:
                case.path_parameters[name] = draw(st.sampled_from(known))
            elif pick == 9:
                case.path_parameters[name] = draw(st.sampled_from(wild))
        if isinstance(case.body, dict) and "file" in case.body and draw(st.booleans()):
            case.body["file"] = [picture()] if isinstance(case.body["file"], list) else picture()
        return case

    return addressed()


def each(strategy, *, examples, call):
    """Call a function with a number of examples of a strategy."""

    @hypothesis.settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=strategy)
    def run(case):
        call(case)

    run()


def state(library, slug):
    """Return what must not change without permission: the records of a map, its photos and its mission."""
    with library.database.read() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        rows = session.query(Photo).filter_by(map_id=record.id).order_by(Photo.id)
        mission = session.query(Mission).filter_by(map_id=record.id).one()
        photos = session.query(MissionPhoto).filter_by(mission_id=mission.id).count()
        return (
            (record.revision, record.name, record.binned_at),
            [(p.x_px, p.removed, p.revision) for p in rows],
            (mission.revision, mission.name, mission.binned_at, photos),
        )


def test_the_document_is_valid_and_describes_every_route(app, document, api):
    api.validate()
    assert document["openapi"].startswith("3.")
    assert document["security"] == [{"token": []}]
    reported = sum(len(operations) for operations in document["paths"].values())
    rules = [r for r in app.url_map.iter_rules() if r.rule.startswith("/api/v1/") and r.rule != PATH]
    assert reported == sum(len(r.methods - {"HEAD", "OPTIONS"}) for r in rules)
    ids = [o["operationId"] for operations in document["paths"].values() for o in operations.values()]
    assert len(ids) == len(set(ids))


def test_every_operation_says_what_it_takes_gives_and_fails_with(document):
    tags = {tag["name"] for tag in document["tags"] if tag["description"]}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            place = f"{method} {path}"
            assert operation["summary"], place
            assert set(operation["tags"]) <= tags, place
            assert all(p["description"] for p in operation["parameters"] if p["in"] == "path"), place
            good = {s: r for s, r in operation["responses"].items() if s < "400"}
            assert good, place
            for status, response in good.items():
                assert status == "204" or response["content"], place
                for kind, content in response.get("content", {}).items():
                    assert content["schema"] or kind != "application/json", place
            bad = [r for s, r in operation["responses"].items() if s >= "400"]
            assert bad and all(r["$ref"].startswith("#/components/responses/Error") for r in bad), place
    for response in document["components"]["responses"].values():
        assert response["content"]["application/json"]["schema"] == {"$ref": "#/components/schemas/Error"}


def test_schemas_have_names_of_their_own(document):
    """A number is appended to a second schema of the same name."""
    assert [name for name in document["components"]["schemas"] if name[-1].isdigit()] == []


def test_the_document_is_the_same_for_everyone(app, document):
    other = app.test_client().get(PATH, headers={"Host": "evil.example"}).json
    assert other == document
    assert document["servers"] == [{"url": "/"}]


def test_who_asks_for_the_document_at_the_same_time_gets_all_of_it(app, owner, sign_in):
    """A process creates it at the first request."""
    browsers = [sign_in(owner) for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        documents = [*pool.map(lambda browser: browser.get("/api/v1/openapi.json").json, browsers)]
    assert all(one == documents[0] for one in documents)
    refs = set(re.findall(r'"#/components/schemas/([^"]+)"', json.dumps(documents[0])))
    assert refs <= set(documents[0]["components"]["schemas"])


def test_every_field_of_the_state_of_a_map_is_documented(client, fresh):
    slug, _ = fresh()
    whole = client.get(f"/api/v1/maps/{slug}").json
    assert whole["photos"] and whole["satellite"] and whole["georeference"]
    assert MapState().dump(whole) == whole
    changes = client.get(f"/api/v1/maps/{slug}/changes").json
    assert changes["jobs"] and MapChanges().dump(changes) == changes


def test_whatever_the_owner_sends_is_answered_as_the_document_says(operations, fresh, owner, token):
    headers = PLAIN | {"Authorization": f"Bearer {token(owner)}"}
    seen = set()

    def call(case):
        answer = case.call_and_validate(headers=headers, checks=CHECKS)
        seen.add(answer.status_code)
        if answer.status_code == 401:  # requests may have revoked their own token
            headers["Authorization"] = f"Bearer {token(owner)}"

    slug, ids = fresh()
    for operation in sorted(operations, key=lambda operation: operation.method != "get"):
        if operation.method != "get":
            slug, ids = fresh()
        each(cases(operation, slug, ids), examples=3, call=call)
    assert {200, 201, 400, 404, 422} <= seen


@pytest.mark.parametrize("value", [0, 1, "", "no", "on", "true"])
def test_true_and_false_of_json_are_no_other_values(client, park, value):
    for path, wish in (("shares", {"photos": value}), ("satellite/blank", {"width": 9, "tray": value})):
        answer = client.post(f"/api/v1/maps/{park}/{path}", json=wish)
        assert answer.status_code == 422, path
        assert next(iter(wish.keys() - {"width"})) in answer.text


def test_unknown_fields_are_refused(client, park):
    for method, path, wish in (
        ("POST", "/api/v1/maps", {"name": "Lake", "revision": 7}),
        ("PATCH", "/api/v1/account", {"name": "Eva", "is_owner": True}),
        ("POST", f"/api/v1/maps/{park}/shares", {"photos": True, "account_id": 1}),
    ):
        assert client.open(path, method=method, json=wish).status_code == 422, path


@pytest.mark.parametrize(
    ("text", "status"), [("1", 200), ("True", 200), ("false", 200), ("0", 200), ("no", 422), ("", 422)]
)
def test_true_and_false_of_addresses_are_texts(client, text, status):
    answer = client.get(f"/api/v1/maps?bin={text}")
    assert answer.status_code == status
    assert status == 422 or answer.json["maps"] == []


def test_what_a_map_without_an_image_answers_is_documented(client, park, document):
    """The exports need an image: 400."""
    values = {"slug": park, "name": "plan", "id": 1, "key": "0" * 32, "number": 0, "z": 0, "x": 0, "y": 0}
    values["sheet"] = "pdf"
    refused = set()
    for path, operations in document["paths"].items():
        if "get" not in operations or not path.startswith("/api/v1/maps/{slug}"):
            continue
        for form in ("zip", "geojson", "kml", "kmz", "html") if "{form}" in path else ("",):
            status = client.get(path.format(**values, form=form)).status_code
            assert status < 400 or str(status) in operations["get"]["responses"], (path, form, status)
            refused |= {path} if status == 400 else set()
    assert {f"/api/v1/maps/{{slug}}/{name}" for name in ("map.cfg", "export.{form}")} <= refused


def test_what_a_map_without_a_georeference_answers_is_documented(client, fresh, document):
    """A walk leads to latitudes and longitudes: 400."""
    slug, _ = fresh()
    client.delete(f"/api/v1/maps/{slug}/georeference")
    assert client.post(f"/api/v1/maps/{slug}/photo-plan", json={"spots": 1}).json["plan"]["spots"]
    answer = client.get(f"/api/v1/maps/{slug}/photo-plan/walk.gpx")
    assert answer.status_code == 400
    assert "400" in document["paths"]["/api/v1/maps/{slug}/photo-plan/walk.gpx"]["get"]["responses"]


def test_what_is_answered_to_viewers_is_documented(document, fresh, library, new_account, sign_in):
    slug, ids = fresh()
    viewer = new_account("Vera")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        accounts.set_member_role(session, record, account=session.merge(viewer), role="viewer")
    client, refused = sign_in(viewer), set()
    values = {"slug": slug, "id": 0, "key": "0" * 32, "number": 0, "z": 0, "x": 0, "y": 0, "form": "zip"}
    values |= {"sheet": "pdf", "name": "plan", "ending": "gpx", "feature": f"{slug}-0"}
    values |= {name: known[0] for name, known in ids.items() if name.endswith("_id") or name == "sha256"}
    for path, operations in document["paths"].items():
        if "get" in operations and OF_THE_MAP.search(path) and not path.endswith("/events"):
            status = client.get(path.format(**values)).status_code
            assert status < 400 or str(status) in operations["get"]["responses"], (path, status)
            refused |= {path} if status == 403 else set()
    assert len(refused) > 3


def test_nobody_gets_in_without_a_sign_in(operations, fresh, library):
    slug, ids = fresh()
    before = state(library, slug)

    def call(case):
        answer = case.call_and_validate(headers=PLAIN | {"Authorization": "Bearer wrong"}, checks=CHECKS)
        assert answer.status_code in (401, 404, 405)

    for operation in operations:
        each(cases(operation, slug, ids, [GenerationMode.POSITIVE]), examples=1, call=call)
    assert state(library, slug) == before


def test_others_get_nothing_of_what_is_not_shared(operations, fresh, library, new_account, token):
    slug, ids = fresh()
    before = state(library, slug)
    headers = PLAIN | {"Authorization": f"Bearer {token(new_account('Mallory'))}"}

    def call(case):
        answer = case.call_and_validate(headers=headers, checks=CHECKS)
        assert answer.status_code >= 400, answer.text

    for operation in operations:
        if any(name in operation.path for name in ("{slug}", "{job_id}", "{mission_id}", "{collection}")):
            each(cases(operation, slug, ids, [GenerationMode.POSITIVE]), examples=1, call=call)
    assert state(library, slug) == before


def test_viewers_change_nothing(operations, fresh, library, new_account, token):
    slug, ids = fresh()
    viewer = new_account("Vera")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        accounts.set_member_role(session, record, account=viewer, role="viewer")
    before = state(library, slug)
    headers = PLAIN | {"Authorization": f"Bearer {token(viewer)}"}

    def call(case):
        case.call_and_validate(headers=headers, checks=CHECKS)

    for operation in operations:
        if OF_THE_MAP.search(operation.path) and operation.method != "get":
            each(cases(operation, slug, ids), examples=2, call=call)
    assert state(library, slug) == before


def test_the_roles_of_every_operation_are_asked_for_before_what_was_sent(
    operations, fresh, new_account, token
):
    """With a valid request, a viewer gets to the check of the role: no 422 hides a missing one."""
    slug, ids = fresh()
    headers = {"Authorization": f"Bearer {token(new_account('Mallory'))}"}
    answered = {}

    def call(case):
        status = case.call(headers=headers).status_code
        answered.setdefault(f"{case.method} {case.path}", set()).add(status)

    for operation in operations:
        if OF_THE_MAP.search(operation.path) and operation.method != "get":
            each(cases(operation, slug, ids, [GenerationMode.POSITIVE]), examples=6, call=call)
    assert {name for name, statuses in answered.items() if not statuses & {403, 404}} == set()
