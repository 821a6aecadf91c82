"""What a share of a mission gives access to and what not, and that revoking it takes effect at once."""

import io
import zipfile

import pytest

from tests.kml_rules import GX, KML, check_kml
from webapp.missions.store.schema import MissionPhoto, MissionShare

SECRETS = ("SECRETNOTE", "SECRETCAM", "SECRETNAME")


def token_of(shared):
    return shared["url"].rpartition("/")[2]


def api(shared, rest=""):
    return f"/api/v1/shared-missions/{token_of(shared)}{rest}"


def every_address(shared, *, track, sha):
    page = shared["url"]
    exports = [f"{page}/export.{form}" for form in ("kml", "kmz", "gpx", "geojson", "csv", "html")]
    exports += [f"{page}/export.report.{form}" for form in ("html", "pdf")]
    result = ["", f"/tracks/{track}/line", f"/tracks/{track}/profile", "/objects", "/objects/c1", "/photos"]
    result += [f"/photos/{sha}/thumb", f"/photos/{sha}/preview"]
    pages = [page, f"{page}/embed", shared["kml"], f"{page}/objects.csv"]
    return pages + exports + [api(shared, rest) for rest in result]


def test_only_a_hash_of_a_secret_link_is_kept(library, client, new_mission, share):
    mission = new_mission()
    shared = share(mission)
    with library.database.read() as session:
        kept = session.query(MissionShare).one()
        assert kept.token_hash != token_of(shared) and kept.public_token is None
    (listed,) = client.get(f"/api/v1/missions/{mission}/shares").json["shares"]
    assert (listed["url"], listed["embed"], listed["kml"], listed["public"]) == (None, None, None, False)


def test_visitors_see_tracks_and_objects(stranger, new_mission, share):
    shared = share(new_mission(30))
    page = stranger.get(shared["url"])
    assert page.status_code == 200 and "noindex" in page.headers["X-Robots-Tag"]
    state = stranger.get(api(shared)).json
    assert (state["name"], state["objects"], state["photos"]) == ("Search", 2, 0)
    (track,) = state["tracks"]
    line = stranger.get(api(shared, f"/tracks/{track['id']}/line")).json
    assert line["points"][0][3] == 14.0 and track["poses"] == 30
    assert [one["id"] for one in stranger.get(api(shared, "/objects")).json["objects"]] == ["c1", "v1"]
    assert len(stranger.get(api(shared, "/objects/v1")).json["sightings"]) == 1


def test_what_is_new_is_sent(stranger, new_mission, share, send):
    mission = new_mission(5)
    shared = share(mission)
    before = stranger.get(api(shared)).json
    send(mission, 5, first=5, objects=[("new", "car")])
    after = stranger.get(api(shared)).json
    assert after["cursor"] != before["cursor"] and after["tracks"][0]["poses"] == 10
    result = stranger.get(api(shared, f"/objects?since={before['revision']}")).json["objects"]
    assert [one["id"] for one in result] == ["new"]


def test_without_photos_there_are_none(stranger, new_mission, share, add_photo):
    mission = new_mission()
    sha = add_photo(mission)
    shared = share(mission)
    assert stranger.get(api(shared, "/photos")).json["photos"] == []
    assert stranger.get(api(shared, "/objects/c1")).json["photo"] is None
    for kind in ("thumb", "preview", "original"):
        assert stranger.get(api(shared, f"/photos/{sha}/{kind}")).status_code == 404


def test_files_exif_and_notes_are_never_given_out(stranger, new_mission, share, add_photo):
    mission = new_mission()
    sha = add_photo(mission)
    shared = share(mission, photos=True)
    (photo,) = stranger.get(api(shared, "/photos")).json["photos"]
    assert stranger.get(photo["url"]).status_code == 200 and photo["object"] == "c1"
    track = stranger.get(api(shared)).json["tracks"][0]["id"]
    for address in every_address(shared, track=track, sha=sha):
        answer = stranger.get(address)
        assert answer.status_code == 200, address
        data = answer.data
        if address.endswith("kmz"):
            archive = zipfile.ZipFile(io.BytesIO(data))
            data = archive.read("doc.kml")
            assert not [name for name in archive.namelist() if "photo" in name]
        assert not [secret for secret in SECRETS if secret.encode() in data], address
    assert stranger.get(api(shared, f"/photos/{sha}/original")).status_code == 404


def test_a_link_that_was_taken_back_leads_nowhere_at_once(client, stranger, new_mission, share, add_photo):
    mission = new_mission()
    sha = add_photo(mission)
    shared, other = share(mission, photos=True, public=True), share(mission)
    track = stranger.get(api(shared)).json["tracks"][0]["id"]
    addresses = every_address(shared, track=track, sha=sha)
    assert {stranger.get(address).status_code for address in addresses} == {200}
    assert client.delete(f"/api/v1/missions/{mission}/shares/{shared['id']}").status_code == 204
    assert {stranger.get(address).status_code for address in addresses} == {404}
    assert stranger.get(other["url"]).status_code == 200
    assert client.get(f"/api/v1/missions/{mission}/link.kml").status_code == 400
    assert client.delete(f"/api/v1/missions/{mission}/shares/{shared['id']}").status_code == 404


def test_a_mission_in_the_bin_is_not_shown(client, stranger, new_mission, share):
    mission = new_mission()
    shared = share(mission, public=True)
    client.delete(f"/api/v1/missions/{mission}")
    for address in (shared["url"], shared["kml"], f"{shared['url']}/export.kmz", api(shared)):
        assert stranger.get(address).status_code == 404
    client.post(f"/api/v1/missions/{mission}/restore")
    assert stranger.get(shared["url"]).status_code == 200


def test_from_one_share_there_is_no_way_to_anything_else(client, stranger, new_mission, share, add_photo):
    mine, other = new_mission(), new_mission()
    sha = add_photo(other)
    shared = share(mine, photos=True)
    track = client.get(f"/api/v1/missions/{other}").json["tracks"][0]["id"]
    for rest in (f"/tracks/{track}/line", f"/tracks/{track}/profile", f"/photos/{sha}/preview"):
        assert stranger.get(api(shared, rest)).status_code == 404
    assert stranger.get(api(shared, "/satellite")).status_code == 404
    for path in ("", "/events", "/query", "/export.kml", "/shares", "/batches"):
        address = f"/api/v1/missions/{mine}{path}"
        assert stranger.get(address).status_code in (401, 405)
        header = {"Authorization": f"Bearer {token_of(shared)}"}
        assert stranger.get(address, headers=header).status_code in (401, 405)
    for odd in ("%", "..", token_of(shared)[:-1], token_of(shared) + "x", "é" * 50):
        assert stranger.get(f"/m/{odd}").status_code == 404
        assert stranger.get(f"/m/{odd}/export.kml").status_code == 404
        assert stranger.get(f"/api/v1/shared-missions/{odd}").status_code in (401, 404)


def test_a_network_link_leads_to_what_is_there_now(stranger, new_mission, share, send):
    mission = new_mission(5)
    shared = share(mission)
    link = check_kml(stranger.get(shared["kml"]).data)
    assert link.find(f".//{KML}refreshMode").text == "onInterval"
    assert link.find(f".//{KML}refreshInterval").text == "10"
    href = link.find(f".//{KML}href").text
    assert href.startswith("http://")

    def poses():
        answer = stranger.get(href)
        assert answer.content_type == "application/vnd.google-earth.kmz"
        assert "no-store" in answer.headers["Cache-Control"]
        root = check_kml(zipfile.ZipFile(io.BytesIO(answer.data)).read("doc.kml"))
        return len(list(root.iter(f"{GX}coord")))

    assert poses() == 5
    send(mission, 7, first=5)
    assert poses() == 12
    send(mission, 3000, first=12)
    assert poses() == 2000


@pytest.mark.parametrize("query", ["every=0", "every=x", "every=", "every=99999999999999999999"])
def test_odd_questions_of_visitors_are_refused(stranger, new_mission, share, query):
    shared = share(new_mission())
    assert stranger.get(f"{shared['kml']}?{query}").status_code == 422
    assert stranger.get(f"{shared['url']}/export.csv?points=1").status_code == 422
    assert stranger.get(f"{shared['url']}/export.csv?other=1").status_code == 200
    assert stranger.get(f"{shared['url']}/export.exe").status_code == 404


@pytest.mark.parametrize("role", ["editor", "viewer"])
def test_only_owners_share(sign_in, new_account, new_map, role):
    ana, bob = new_account("Ana"), new_account("Bob")
    slug = new_map(ana, shared={bob: role})
    mission = sign_in(ana).post("/api/v1/missions", json={"name": "m", "map": slug}).json["id"]
    where = f"/api/v1/missions/{mission}/shares"
    id = sign_in(ana).post(where, json={}).json["id"]
    browser = sign_in(bob)
    assert browser.get(where).status_code == 403
    assert browser.post(where, json={}).status_code == 403
    assert browser.patch(f"{where}/{id}", json={}).status_code == 403
    assert browser.delete(f"{where}/{id}").status_code == 403
    assert sign_in(new_account("Eve")).get(where).status_code == 404


def test_the_owner_changes_what_a_share_gives(client, stranger, new_mission, share, add_photo):
    mission = new_mission()
    sha = add_photo(mission)
    shared = share(mission)
    where = f"/api/v1/missions/{mission}/shares/{shared['id']}"
    assert client.patch(where, json={"photos": True}).json["photos"] is True
    assert stranger.get(api(shared, f"/photos/{sha}/thumb")).status_code == 200
    assert client.patch(where, json={"photos": False}).json["photos"] is False
    assert stranger.get(api(shared, f"/photos/{sha}/thumb")).status_code == 404


def test_public_missions_are_listed_and_secret_ones_are_not(client, stranger, new_mission, share):
    mission = new_mission(name="Yard round")
    share(mission)
    assert "Yard round" not in stranger.get("/public").text
    shared = share(mission, public=True)
    assert f'href="/m/{token_of(shared)}"' in stranger.get("/public").text
    assert "X-Robots-Tag" not in stranger.get(shared["url"]).headers
    client.delete(f"/api/v1/missions/{mission}")
    assert "Yard round" not in stranger.get("/public").text


def test_only_the_embedded_page_may_be_framed_and_it_sets_no_cookie(stranger, new_mission, share):
    shared = share(new_mission(name='"><script>alert(1)</script>'))
    assert shared["embed"].startswith("<iframe ") and "<script>" not in shared["embed"]
    framed = stranger.get(shared["url"] + "/embed")
    assert "frame-ancestors *" in framed.headers["Content-Security-Policy"]
    assert "X-Frame-Options" not in framed.headers and "Set-Cookie" not in framed.headers
    assert "<script>alert(1)" not in framed.text
    assert stranger.get(shared["url"]).headers["X-Frame-Options"] == "DENY"


def test_why_a_photo_could_not_be_localized_is_not_shown(stranger, library, new_mission, share, add_photo):
    mission = new_mission()
    sha = add_photo(mission)
    with library.database.write() as session:
        photo = session.get(MissionPhoto, (mission, sha))
        photo.fix, photo.fix_state = {"error": "SECRETNAME.jpg: damaged"}, "failed"
    (result,) = stranger.get(api(share(mission, photos=True), "/photos")).json["photos"]
    assert (result["sha256"], result["fix"]) == (sha, None)
