"""Import and export of maps through the API, only for those who may see them."""

import io
import json
import unicodedata
import zipfile

import pytest
from PIL import Image

from tests.web.maps.test_photo_uploads import jpeg
from webapp.errors import Conflict, NotFound
from webapp.files.exchange import map_zip
from webapp.files.listing import folded
from webapp.jobs import map_jobs
from webapp.jobs.context import Context, JobProgress
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease, Limits
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import adopt_map
from webapp.web.maps import api_exchange

GEO = {
    "format": "experience-map",
    "version": 1,
    "next_id": 3,
    "georeference": {
        "plane": "EPSG:4326",
        "plane_from_pixel": [[1e-5, 0, 26.5], [0, -1e-5, 60.4], [0, 0, 1]],
        "method": "corners",
    },
}


@pytest.fixture
def park(library, owner, make_map):
    """The slug of a map of the owner, with three placed photos and a georeference."""
    cfg = make_map(library.map_folder("park"), 3)
    cfg.with_name("map.json").write_text(json.dumps(GEO))
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    return "park"


@pytest.fixture
def work(library, settings):
    """Run the next job, and return its result."""

    def run(function):
        with library.database.write() as session:
            job = jobs.lease(session, "test", limits=Limits(60, 3))
            while job.kind not in ("import", "export"):
                job.state = "done"
                session.flush()
                job = jobs.lease(session, "test", limits=Limits(60, 3))
            lease = Lease(job.id, job.fence)
            known = (job.map_id, job.account_id, job.arguments)
        return function(Context(library, settings, JobProgress(), lease, *known))

    return run


def zipped(files):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return content.getvalue()


def bring(client, content, filename="Park.zip", **fields):
    return client.post("/api/v1/maps/import", data={"file": (io.BytesIO(content), filename), **fields})


@pytest.mark.parametrize(
    ("what", "media_type", "begins"),
    [
        ("map.cfg", "text/plain; charset=utf-8", b"plan.png;400;200\n"),
        ("export.zip", "application/zip", b"PK"),
        ("export.geojson", "application/geo+json", b"{"),
        ("export.kml", "application/vnd.google-earth.kml+xml", b"<?xml"),
        ("export.kmz", "application/vnd.google-earth.kmz", b"PK"),
        ("export.html", "text/html; charset=utf-8", b"<!DOCTYPE html>"),
        ("export.csv", "text/csv; charset=utf-8", b"SourceFile,GPSLatitude"),
    ],
)
def test_every_export_is_a_file_to_save(client, park, what, media_type, begins):
    answer = client.get(f"/api/v1/maps/{park}/{what}")
    assert answer.status_code == 200 and answer.data.startswith(begins)
    assert answer.content_type == media_type
    ending = what.rsplit(".", 1)[-1]
    assert answer.headers["Content-Disposition"] == f"attachment; filename={park}.{ending}"


@pytest.mark.parametrize(("form", "name"), [("exif", "photos"), ("xmp", "xmp")])
def test_positions_leave_as_a_zip(client, park, form, name):
    answer = client.get(f"/api/v1/maps/{park}/export.{form}")
    assert answer.headers["Content-Disposition"] == f"attachment; filename={park}-{name}.zip"
    with zipfile.ZipFile(io.BytesIO(answer.data)) as archive:
        assert archive.testzip() is None and archive.namelist()


def test_exports_that_are_none(client, park, new_map, owner):
    assert client.get(f"/api/v1/maps/{park}/export.exe").status_code == 404
    assert client.get(f"/api/v1/maps/{park}/placements/none.cfg").status_code == 404
    assert client.get(f"/api/v1/maps/{park}/exports/..%2Fmap.cfg").status_code == 404
    empty = client.get(f"/api/v1/maps/{new_map(owner, name='Empty')}/map.cfg")
    assert empty.status_code == 400 and "satellite" in empty.json["error"]["hint"]


def test_without_georeference_it_says_what_to_do(client, park, library):
    with library.database.write() as session:
        session.query(MapRecord).one().georeference = None
    answer = client.get(f"/api/v1/maps/{park}/export.kmz")
    assert answer.status_code == 400 and "georeference" in answer.json["error"]["hint"]


def test_only_those_who_may_see_a_map_take_it_away(stranger, sign_in, new_account, park):
    other = sign_in(new_account("eva"))
    for what in ("map.cfg", "export.zip", "findings", "health", "outside-edit"):
        assert stranger.get(f"/api/v1/maps/{park}/{what}").status_code == 401
        assert other.get(f"/api/v1/maps/{park}/{what}").status_code == 404
    assert other.post(f"/api/v1/maps/{park}/duplicate", json={}).status_code == 404


def test_an_exported_zip_is_imported_as_a_new_map(client, park):
    content = client.get(f"/api/v1/maps/{park}/export.zip").data
    answer = bring(client, content, "some.zip", name="Můj park")
    assert answer.status_code == 201
    assert answer.json == {"slug": "muj-park", "job": None, "findings": [], "left_out": []}
    assert client.get("/api/v1/maps/muj-park").json["name"] == "Můj park"
    assert client.get("/api/v1/maps/muj-park/map.cfg").data == client.get(f"/api/v1/maps/{park}/map.cfg").data


@pytest.mark.parametrize("at_once", [True, False])
def test_an_imported_map_has_its_title(client, park, monkeypatch, at_once):
    client.patch(f"/api/v1/maps/{park}", json={"name": "Stará obora"})
    content = client.get(f"/api/v1/maps/{park}/export.zip").data
    if not at_once:
        monkeypatch.setattr(api_exchange, "is_quick", lambda _archive, limits: False)
    slug = bring(client, content, "park (3).zip").json["slug"]
    assert slug == "stara-obora-2"
    assert client.get(f"/api/v1/maps/{slug}").json["name"] == "Stará obora (2)"


@pytest.mark.parametrize(
    "json_text", [None, "{", json.dumps({**GEO, "title": "x" * 200}), json.dumps({**GEO, "title": " \n"})]
)
def test_a_map_without_a_usable_title_has_the_name_of_its_file(app, tmp_path, json_text):
    files = {"map.cfg": "plan.png;10;10\n", **({} if json_text is None else {"map.json": json_text})}
    for content in (zipped(files), b"no zip"):
        (tmp_path / "a.zip").write_bytes(content)
        with app.app_context():
            name = api_exchange._name_of(None, tmp_path / "a.zip", "Můj park.zip")
        assert name == "Můj park"


def test_the_title_of_a_large_map_is_read_without_its_records(app, tmp_path, monkeypatch):
    monkeypatch.setattr(map_zip, "parse_map_json", None)
    about = {"format": "experience-map", "version": 1, "title": 'Stará "obora"'}
    text = json.dumps({**about, "notes": [{"title": "other"}], "unplaced": [{}] * 200_000}, indent=1)
    (tmp_path / "a.zip").write_bytes(zipped({"map.cfg": "", "map.json": text}))
    with app.app_context():
        assert api_exchange._name_of(None, tmp_path / "a.zip", "a.zip") == 'Stará "obora"'


@pytest.mark.parametrize("filename", ["../../etc/passwd", "\x07.zip", "", "a\\b.zip", "x" * 500 + ".zip"])
def test_names_of_files_are_only_names(client, park, filename, library):
    content = client.get(f"/api/v1/maps/{park}/export.zip").data
    answer = bring(client, content, filename or "x")
    assert answer.status_code == 201
    assert (library.folder / answer.json["slug"] / "map.cfg").is_file()


def test_all_errors_of_an_imported_map_are_reported(client):
    answer = bring(client, zipped({"map.cfg": "plan.png;10;10\n0;a.jpg;1;2;3\n0;b.jpg;x;1\n"}))
    assert answer.status_code == 422
    assert {finding["code"] for finding in answer.json["findings"]} >= {
        "wrong-column-count",
        "missing-satellite",
    }
    assert answer.json["error"]["code"] == "map_refused" and answer.json["error"]["hint"]


@pytest.mark.parametrize("content", [b"", b"hello", zipped({}), zipped({"../map.cfg": b"x"})])
def test_what_is_no_map_is_refused_and_leaves_nothing(client, library, content):
    answer = bring(client, content)
    assert answer.status_code == 422 and answer.json["error"]["message"]
    assert str(library.folder) not in answer.text
    assert [path.name for path in library.folder.iterdir()] == [".library"]
    assert list((library.inner / "imports").iterdir()) == []


def test_an_import_without_a_file(client):
    assert client.post("/api/v1/maps/import", data={"name": "x"}).status_code == 422
    assert client.post("/api/v1/maps/import", json={}).status_code in (415, 422)


def test_a_large_zip_is_imported_by_a_job(client, park, work, monkeypatch, library):
    monkeypatch.setattr(map_zip, "_QUICK_BYTES", 1000)
    answer = bring(client, client.get(f"/api/v1/maps/{park}/export.zip").data, name="Later")
    assert answer.status_code == 202 and answer.json["slug"] == "later"
    assert client.get("/api/v1/maps/later").json["photos"] == []
    assert work(map_jobs.import_map_zip) == {"findings": [], "left_out": []}
    assert len(client.get("/api/v1/maps/later").json["photos"]) == 3
    assert list((library.inner / "imports").iterdir()) == []


def test_photos_whose_names_look_alike_stay_apart(client, park, library):
    """Spelled in two normal forms, in capitals, and with a Cyrillic letter: as files, and through a zip."""
    names = [unicodedata.normalize(form, "v\u00fdlet.jpg") for form in ("NFC", "NFD")]
    names += ["V\u00ddLET.JPG", "v\u00fdl\u0435t.jpg"]
    files = [(io.BytesIO(jpeg(n, side=40 + n)), name) for n, name in enumerate(names)]
    answers = client.post(f"/api/v1/maps/{park}/photos", data={"file": files}).json
    assert all("error" not in answer for answer in answers)
    sides = sides_of(client, park)
    assert set(range(40, 44)) <= set(sides)
    with library.database.read() as session:
        files = [photo.path for photo in session.query(Photo)]
    assert len({folded(name) for name in files}) == len(sides), "also where case does not count"
    bring(client, client.get(f"/api/v1/maps/{park}/export.zip").data, name="Again")
    assert sides_of(client, "again") == sides


def sides_of(client, slug):
    return sorted(photo["width"] for photo in client.get(f"/api/v1/maps/{slug}").json["photos"])


@pytest.mark.parametrize("when", ["waiting", "read"])
@pytest.mark.parametrize("permanently", [False, True])
def test_a_map_that_is_deleted_during_its_import(client, park, work, monkeypatch, library, when, permanently):
    """Nothing of the zip is left in the library but, in the bin, the empty map."""
    monkeypatch.setattr(map_zip, "_QUICK_BYTES", 1000)
    bring(client, client.get(f"/api/v1/maps/{park}/export.zip").data, name="Later")

    def delete():
        for query in ("", "?forever=true")[: 1 + permanently]:
            assert client.delete(f"/api/v1/maps/later{query}").status_code == 200

    def run(context):
        if when == "waiting":
            delete()
        with pytest.raises((NotFound, Conflict)):
            map_jobs.import_map_zip(context)

    read = adopt_map.read
    if when == "read":
        monkeypatch.setattr(adopt_map, "read", lambda *given, **named: (read(*given, **named), delete())[0])
    work(run)
    with library.database.read() as session:
        assert session.query(Photo).count() == 3, "those of the other map"
    assert not list(library.folder.glob("later*/*")), "no files outside the bin"
    folders = [path for path in (library.inner / "imports").iterdir() if path.is_dir()]
    assert folders == [], "only the archive waits for the sweep"


def test_a_small_zip_with_many_lines_is_imported_by_a_job(client):
    lines = "".join(f"{i};p{i}.jpg;1;1\n" for i in range(20_000))
    answer = bring(client, zipped({"map.cfg": f"plan.png;2;2\n{lines}".encode()}), name="Many")
    assert answer.status_code == 202


def picture(width, height):
    content = io.BytesIO()
    Image.new("1", (width, height)).save(content, "PNG")
    return content.getvalue()


@pytest.mark.parametrize(
    "files",
    [
        {"huge.png": picture(7000, 7000)},
        {f"p{n}.png": picture(2500, 2500) for n in range(8)},
        {"map.json": b"[" + b"{}," * 130_000},
        {f"p{n}.png": b"x" for n in range(400)},
    ],
    ids=["pixels of one photo", "pixels of all photos", "records", "files"],
)
def test_a_small_zip_that_takes_long_is_imported_by_a_job(client, files):
    answer = bring(client, zipped({"map.cfg": b"plan.png;2;2\n", **files}), name="Long")
    assert answer.status_code == 202


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_zip_in_an_unusual_compression_is_refused(client, method):
    """Its decoders have no limit: a few kilobytes become gigabytes."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as archive:
        archive.writestr("map.cfg", b"plan.png;2;2\n")
    answer = bring(client, content.getvalue(), name="Unusual")
    assert answer.status_code == 422
    assert "unusual method" in answer.json["error"]["message"]


def test_an_export_by_a_job_is_fetched(client, park, work):
    answer = client.post(f"/api/v1/maps/{park}/exports", json={"format": "kmz"})
    assert answer.status_code == 202
    done = work(map_jobs.export_map_file)
    with client.get(f"/api/v1/maps/{park}/exports/{done['file']}") as fetched:
        assert fetched.data.startswith(b"PK") and "attachment" in fetched.headers["Content-Disposition"]
    assert client.post(f"/api/v1/maps/{park}/exports", json={"format": "exe"}).status_code == 422


def test_a_copy(client, sign_in, new_account, park, library):
    answer = client.post(f"/api/v1/maps/{park}/duplicate", json={})
    assert (answer.status_code, answer.json["slug"]) == (201, "park-copy")
    assert client.get("/api/v1/maps/park-copy").json["name"] == "Park (copy)"
    named = client.post(f"/api/v1/maps/{park}/duplicate", json={"name": "Another"})
    assert named.json["slug"] == "another"
    assert len(client.get("/api/v1/maps/another").json["photos"]) == 3


def test_deleted_for_good_only_from_the_bin(client, park, library):
    assert client.delete(f"/api/v1/maps/{park}?forever=true").status_code == 409
    assert client.delete(f"/api/v1/maps/{park}").status_code == 200
    assert client.delete(f"/api/v1/maps/{park}?forever=true").json["slug"] == park
    assert client.get(f"/api/v1/maps/{park}").status_code == 404
    assert not library.map_folder(park).exists()


def test_an_import_without_a_name_of_its_own_gets_a_number(client, park):
    """To distinguish it from its original; a name that was given is kept."""
    content = client.get(f"/api/v1/maps/{park}/export.zip").data
    names = [client.get(f"/api/v1/maps/{bring(client, content).json['slug']}").json["name"] for _ in range(2)]
    original = client.get(f"/api/v1/maps/{park}").json["name"]
    assert names == [f"{original} (2)", f"{original} (3)"]
    assert bring(client, content, name=original).status_code in (200, 201, 202)
    assert [one["name"] for one in client.get("/api/v1/maps").json["maps"]].count(original) == 2
