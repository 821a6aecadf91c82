"""What a share gives access to and what not, and revoking it."""

import io
import json
from types import SimpleNamespace

import piexif
import pytest
from PIL import Image
from sqlalchemy import select

from webapp.errors import NotFound
from webapp.store import queries, sharing
from webapp.store.maps import maps
from webapp.store.schema import Job, MapRecord, QueryRecord, Share
from webapp.tasks.localize import upload
from webapp.tasks.localize.upload import LocalizeResult

SECRETS = ("IMG_GPS", "2019:05:04", "2019-05-04", "50.1", '"exif"')
"""Contents of the files that only the owner may disclose."""


@pytest.fixture
def stranger(stranger):
    """A visitor, who closes each received file."""
    real = stranger.get

    def get(*args, **options):
        answer = real(*args, **options)
        answer.get_data()
        answer.close()
        return answer

    stranger.get = get
    return stranger


def jpeg(shade, *, exif=True):
    """Return a JPEG with GPS, a time, and a maker's name."""
    gps = {
        piexif.GPSIFD.GPSLatitudeRef: b"N",
        piexif.GPSIFD.GPSLatitude: ((50, 1), (6, 1), (0, 1)),
        piexif.GPSIFD.GPSLongitudeRef: b"E",
        piexif.GPSIFD.GPSLongitude: ((14, 1), (25, 1), (0, 1)),
    }
    tags = {"0th": {piexif.ImageIFD.Make: b"SECRETCAM"}, "GPS": gps}
    tags["Exif"] = {piexif.ExifIFD.DateTimeOriginal: b"2019:05:04 10:00:00"}
    file = io.BytesIO()
    more = {"exif": piexif.dump(tags)} if exif else {}
    Image.new("RGB", (64, 48), (shade, 90, 90)).save(file, "JPEG", **more)
    return file.getvalue()


@pytest.fixture
def full(client, park):
    """The slug of a map with an image and three photos, two of them placed."""
    image = io.BytesIO()
    Image.new("RGB", (300, 200), "green").save(image, "JPEG", exif=piexif.dump({"0th": {271: b"SECRETCAM"}}))
    image.seek(0)
    assert client.put(f"/api/v1/maps/{park}/satellite", data={"file": (image, "s.jpg")}).status_code == 200
    for n in range(3):
        data = {"file": [(io.BytesIO(jpeg(40 + 50 * n)), f"IMG_GPS_{n}.jpg")]}
        assert client.post(f"/api/v1/maps/{park}/photos", data=data).json[0]["id"] == n
    changes = [{"id": n, "x_px": 10.0 * n + 5, "y_px": 20.0} for n in range(2)]
    assert client.patch(f"/api/v1/maps/{park}/experiences", json={"changes": changes}).status_code == 200
    return park


@pytest.fixture
def answer(library, full, owner):
    """The id of an answer that names photo 1."""
    form = {
        "query": "IMG_GPS_Q.jpg",
        "fov_deg": 61.0,
        "fov_source": "exif",
        "hypotheses": [{"rank": 1, "x_px": 15.0, "y_px": 20.0, "experiences": [1], "probability": 0.9}],
        "off_map_probability": 0.1,
        "other_probability": 0.0,
    }
    facts = {"options": {}, "evidence": [], "width": 64, "height": 48, "account_id": owner.id}
    row = QueryRecord(name="IMG_GPS_Q.jpg", file="q.jpg", answer=form, **facts)
    with library.database.write() as session:
        record = maps.find(session, full, account=owner)
        queries.add(session, record, row=row, most=9)
        folder = queries.folder(library, record.id)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "q.jpg").write_bytes(jpeg(200))
    return row.id


@pytest.fixture
def share(client, full):
    """Share the map or an answer, and return the response to the owner."""

    def make(slug=full, **wish):
        answer = client.post(f"/api/v1/maps/{slug}/shares", json=wish)
        assert answer.status_code == 201, answer.text
        return answer.json

    return make


def token_of(shared):
    return shared["url"].rpartition("/")[2]


def api(shared, rest=""):
    return f"/api/v1/shared/{token_of(shared)}{rest}"


def addresses(state):
    """Yield every address in a state."""
    text = json.dumps(state).replace("{z}/{x}/{y}", "0/0/0")
    return [part for part in text.split('"') if part.startswith("/")]


def test_only_a_hash_of_a_secret_link_is_kept(library, client, full, share):
    token = token_of(share())
    with library.database.read() as session:
        kept = session.query(Share).one()
        assert kept.token_hash != token and kept.public_token is None
    listed = client.get(f"/api/v1/maps/{full}/shares").json["shares"]
    assert [(one["url"], one["embed"], one["public"]) for one in listed] == [(None, None, False)]
    files = [path for path in library.folder.rglob("*") if path.is_file()]
    assert files and not [path for path in files if token.encode() in path.read_bytes()]


def test_a_visitor_sees_the_map_and_its_dots(stranger, share):
    shared = share()
    page = stranger.get(shared["url"])
    assert page.status_code == 200 and "noindex" in page.headers["X-Robots-Tag"]
    state = stranger.get(api(shared)).json
    assert [(p["id"], p["x_px"]) for p in state["photos"]] == [(0, 5.0), (1, 15.0)]
    assert state["answer"] is None
    assert stranger.get(state["satellite"]["url"]).status_code == 200


def test_without_pictures_there_are_none(stranger, share):
    shared = share()
    assert {p["thumb"] for p in stranger.get(api(shared)).json["photos"]} == {None}
    for rest in ("/photos/0/thumb", "/photos/0/preview", "/photos/0/original", "/query/thumb"):
        assert stranger.get(api(shared, rest)).status_code == 404


def test_pictures_have_no_exif_and_unplaced_photos_are_not_shown(stranger, share):
    shared = share(photos=True)
    state = stranger.get(api(shared)).json
    for photo in state["photos"]:
        for kind in ("thumb", "preview"):
            picture = stranger.get(photo[kind])
            assert picture.status_code == 200
            assert "exif" not in Image.open(io.BytesIO(picture.data)).info
    assert stranger.get(api(shared, "/photos/2/thumb")).status_code == 404
    assert stranger.get(api(shared, "/photos/0/original")).status_code == 404


def test_nothing_of_exif_is_shown_unless_the_owner_allows_it(stranger, share, answer):
    for wish in ({"photos": True}, {"photos": True, "query": answer}):
        shared = share(**wish)
        for text in (stranger.get(api(shared)).text, stranger.get(shared["url"]).text):
            assert not [secret for secret in SECRETS if secret in text]
        for address in addresses(stranger.get(api(shared)).json):
            got = stranger.get(address)
            assert b"SECRETCAM" not in got.data and b"2019:05" not in got.data, address


def test_whom_a_photo_is_from_is_always_named(library, client, stranger, full, share, owner):
    source = {"service": "Street", "id": "s-1", "licence": "CC BY 4.0", "url": "https://a.example/s-1"}
    with library.database.write() as session:
        maps.photo(session, maps.find(session, full, account=owner), 0).source = source
    expected = {**source, "credit": "© Street (CC BY 4.0)"}
    own = client.get(f"/api/v1/maps/{full}").json["photos"]
    assert [photo["source"] for photo in own] == [expected, None, None]
    shown = stranger.get(api(share())).json["photos"]
    assert [photo["source"] for photo in shown] == [expected, None]


def test_the_owner_can_give_files_out(stranger, share, answer):
    shared = share(photos=True, originals=True, query=answer)
    state = stranger.get(api(shared)).json
    assert state["answer"]["name"] == "IMG_GPS_Q.jpg" and state["answer"]["fov_source"] == "exif"
    assert b"SECRETCAM" in stranger.get(state["answer"]["original"]).data
    assert b"SECRETCAM" in stranger.get(state["photos"][1]["original"]).data
    assert state["photos"][0]["original"] is None


def test_a_shared_answer_shows_only_the_photos_it_speaks_of(stranger, share, answer):
    shared = share(photos=True, query=answer)
    state = stranger.get(api(shared)).json
    assert [bool(p["thumb"]) for p in state["photos"]] == [False, True]
    assert stranger.get(api(shared, "/photos/1/preview")).status_code == 200
    assert stranger.get(api(shared, "/photos/0/preview")).status_code == 404
    assert stranger.get(state["answer"]["preview"]).status_code == 200
    assert state["answer"]["hypotheses"][0]["x_px"] == 15.0


def test_a_link_that_was_taken_back_leads_nowhere(client, stranger, full, share):
    shared, other = share(photos=True), share()
    before = [shared["url"], shared["url"].replace("/s/", "/embed/"), api(shared)]
    before += addresses(stranger.get(api(shared)).json)
    assert len(before) > 6
    assert {stranger.get(address).status_code for address in before} == {200}
    assert client.delete(f"/api/v1/maps/{full}/shares/{shared['id']}").status_code == 204
    assert {stranger.get(address).status_code for address in before} == {404}
    assert stranger.get(other["url"]).status_code == 200
    assert client.delete(f"/api/v1/maps/{full}/shares/{shared['id']}").status_code == 404


def test_a_map_in_the_bin_is_not_shown(client, stranger, full, share):
    shared = share(public=True)
    client.delete(f"/api/v1/maps/{full}")
    assert stranger.get(shared["url"]).status_code == 404
    assert stranger.get(api(shared, "/satellite")).status_code == 404
    assert "Park" not in stranger.get("/public").text
    client.post(f"/api/v1/maps/{full}/restore")
    assert stranger.get(shared["url"]).status_code == 200


def test_a_deleted_map_or_answer_takes_its_shares_along(library, client, full, share, answer):
    share(query=answer)
    assert client.delete(f"/api/v1/maps/{full}/queries/{answer}").status_code == 204
    with library.database.read() as session:
        assert session.query(Share).count() == 0


def test_from_one_share_there_is_no_way_to_anything_else(library, stranger, new_map, owner, share, full):
    other = new_map(owner, name="Hidden")
    shared = share(photos=True, localize=True)
    with library.database.read() as session:
        assert session.query(MapRecord).count() == 2
    for path in (
        f"/api/v1/maps/{full}",
        f"/api/v1/maps/{other}",
        f"/api/v1/maps/{full}/satellite",
        f"/api/v1/maps/{full}/photos/0/thumb",
        f"/api/v1/maps/{full}/shares",
        f"/api/v1/maps/{full}/queries",
        "/api/v1/maps",
        "/api/v1/jobs",
    ):
        token = token_of(shared)
        assert stranger.get(path).status_code == 401
        assert stranger.get(path, headers={"Authorization": f"Bearer {token}"}).status_code == 401
    for odd in ("", "%", "../maps", token_of(shared)[:-1], token_of(shared) + "x"):
        assert stranger.get(f"/api/v1/shared/{odd}").status_code == 404
    for address in addresses(stranger.get(api(shared)).json):
        assert address.startswith(api(shared)), address


def test_a_share_of_one_map_shows_no_photo_of_another(client, stranger, share, new_map, owner):
    empty = new_map(owner, name="Empty")
    shared = share(empty, photos=True, originals=True)
    for n in range(3):
        assert stranger.get(api(shared, f"/photos/{n}/preview")).status_code == 404
    assert client.post(f"/api/v1/maps/{empty}/shares", json={"query": 1}).status_code == 404


@pytest.mark.parametrize("role", ["editor", "viewer"])
def test_only_owners_share(sign_in, new_account, new_map, role):
    ana, bob = new_account("Ana"), new_account("Bob")
    slug = new_map(ana, shared={bob: role})
    where = f"/api/v1/maps/{slug}/shares"
    id = sign_in(ana).post(where, json={}).json["id"]
    browser = sign_in(bob)
    assert browser.get(where).status_code == 403
    assert browser.post(where, json={}).status_code == 403
    assert browser.patch(f"{where}/{id}", json={}).status_code == 403
    assert browser.delete(f"{where}/{id}").status_code == 403


def test_the_owner_changes_what_a_share_gives(client, stranger, full, share):
    shared = share()
    changed = client.patch(f"/api/v1/maps/{full}/shares/{shared['id']}", json={"photos": True})
    assert changed.status_code == 200 and changed.json["photos"]
    assert stranger.get(api(shared, "/photos/0/thumb")).status_code == 200


def test_public_maps_are_listed_and_secret_ones_are_not(stranger, share, new_map, owner):
    page = stranger.get("/public").text
    assert "No map is public" in page
    assert "decide under Share" in page
    share()
    assert "No map is public" in stranger.get("/public").text
    open_to_all = share(public=True)
    page = stranger.get("/public").text
    assert f'href="/s/{token_of(open_to_all)}"' in page
    assert "X-Robots-Tag" not in stranger.get(open_to_all["url"]).headers


def test_only_the_embedded_page_may_be_framed_and_it_sets_no_cookie(stranger, share):
    shared = share()
    framed = stranger.get(shared["url"].replace("/s/", "/embed/"))
    assert "frame-ancestors *" in framed.headers["Content-Security-Policy"]
    assert "X-Frame-Options" not in framed.headers and "Set-Cookie" not in framed.headers
    for other in (shared["url"], "/public", "/sign-in"):
        page = stranger.get(other)
        assert "frame-ancestors 'none'" in page.headers["Content-Security-Policy"]
        assert page.headers["X-Frame-Options"] == "DENY"


def test_the_embed_tag_is_safe_html(share, new_map, owner):
    slug = new_map(owner, name='"><script>alert(1)</script>')
    tag = share(slug)["embed"]
    assert tag.startswith("<iframe ") and "<script>" not in tag and "/embed/" in tag


@pytest.fixture
def asked(monkeypatch):
    """Names of the localized photos; each gets the answer "not on this map"."""
    names = []

    def run(_maps, _map_id, *, request):
        names.append(request.photos[0].name)
        form = {"query": names[-1], "hypotheses": [], "off_map_probability": 1.0, "other_probability": 0.0}
        form["seconds"] = {}
        return LocalizeResult(
            form, (), 0, SimpleNamespace(calibrated=True, not_indexed=0, to_calibrate=False)
        )

    monkeypatch.setattr(upload, "localize_uploads", run)
    return names


def ask(browser, shared):
    browser.csrf = False
    return browser.post(api(shared, "/localize"), data={"file": (io.BytesIO(jpeg(9)), "mine.jpg")})


def test_visitors_localize_where_the_owner_allows_it(library, client, full, stranger, share, asked):
    assert ask(stranger, share()).status_code == 404
    assert asked == []
    result = ask(stranger, share(localize=True))
    assert result.status_code == 200 and result.json["off_map_probability"] == 1.0
    assert client.get(f"/api/v1/maps/{full}/queries").json["queries"] == []
    assert list(library.uploads.glob("*.part")) == []


def test_visitors_get_the_first_look_as_an_event(library, stranger, share, asked, monkeypatch):
    answer = upload.localize_uploads

    def report_first(maps, map_id, *, request):
        request.send("first", answer(maps, map_id, request=request).form)
        return answer(maps, map_id, request=request)

    monkeypatch.setattr(upload, "localize_uploads", report_first)
    stranger.environ_base["HTTP_ACCEPT"] = "text/event-stream, application/json;q=0.5"
    events = ask(stranger, share(localize=True)).get_data(as_text=True).split("\n\n")[:-1]
    assert [event.split("\n")[0] for event in events] == ["event: first", "event: answer"]
    assert list(library.uploads.glob("*.part")) == []


def test_a_map_is_indexed_first_for_a_visitor_who_waits(library, full, stranger, share):
    answer = ask(stranger, share(localize=True))
    assert (answer.status_code, answer.json["error"]["code"]) == (409, "not_ready")
    with library.database.read() as session:
        (job,) = session.scalars(select(Job).where(Job.state == "queued"))
        assert (job.kind, job.urgent) == ("index", True) and job.asked_at is not None


def test_visitors_cannot_ask_without_end(stranger, share, asked, settings):
    shared = share(localize=True)
    most = settings.web.visitor_questions_per_minute
    statuses = [ask(stranger, shared).status_code for _ in range(most + 1)]
    assert statuses == [200] * most + [429]
    assert ask(stranger, shared).headers["Retry-After"] == "60"


def test_a_shared_answer_answers_nothing_else(stranger, share, answer, asked):
    assert ask(stranger, share(query=answer, localize=True)).status_code == 404


def test_shares_are_found_by_their_token_alone(library, full, owner):
    with library.database.write() as session:
        record = maps.find(session, full, account=owner)
        made, token = sharing.create(session, record, allows=sharing.SharePermissions(), account_id=owner.id)
        assert sharing.open_share(session, token).map.id == record.id
        with pytest.raises(NotFound):
            sharing.open_share(session, made.token_hash)


def test_visitors_do_not_take_all_threads(app, stranger, share, asked):
    shared = share(localize=True)
    permits = app.extensions["expmap_concurrency"]["visitors"]
    taken = 0
    while permits.acquire(blocking=False):
        taken += 1
    answer = ask(stranger, shared)
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "1")
    assert answer.json["error"]["code"] == "busy"
    permits.release(taken)
    assert ask(stranger, shared).status_code == 200
    assert taken == 2, "of the 8 threads of a process"


def test_a_share_says_who_made_it_also_when_that_account_is_gone(client, sign_in, new_account, new_map):
    ana, bob = new_account("Ana"), new_account("Bob")
    slug = new_map(ana, shared={bob: "owner"})
    where = f"/api/v1/maps/{slug}/shares"
    assert sign_in(bob).post(where, json={}).json["maker"] == "Bob"
    assert [share["maker"] for share in sign_in(ana).get(where).json["shares"]] == ["Bob"]
    assert client.delete(f"/api/v1/accounts/{bob.id}").status_code == 204
    (share,) = sign_in(ana).get(where).json["shares"]
    assert share["maker"] is None


def test_links_of_removed_accounts_are_counted_and_revoked(client, sign_in, new_account, new_map, stranger):
    bob = new_account("Bob")
    slug = new_map(bob)
    browser = sign_in(bob)
    mission = browser.post("/api/v1/missions", json={"name": "Round"}).json["id"]
    for path in (f"maps/{slug}/shares", f"maps/{slug}/shares", f"missions/{mission}/shares"):
        assert browser.post(f"/api/v1/{path}", json={}).status_code == 201
    url = browser.post(f"/api/v1/maps/{slug}/shares", json={}).json["url"]
    assert "Links of removed accounts" not in client.get("/people").text
    assert client.delete(f"/api/v1/accounts/{bob.id}").status_code == 204
    assert "4 links that removed accounts made are still open" in client.get("/people").text
    assert stranger.get(url).status_code == 200
    assert stranger.delete("/api/v1/accounts/removed/shares").status_code == 401
    assert sign_in(new_account("Eve")).delete("/api/v1/accounts/removed/shares").status_code == 403
    answer = client.post("/people/removed/revoke-shares", follow_redirects=True)
    assert "4 links have been revoked" in answer.text and "Links of removed accounts" not in answer.text
    assert stranger.get(url).status_code == 404
    assert client.delete("/api/v1/accounts/removed/shares").json == {"revoked": 0}
