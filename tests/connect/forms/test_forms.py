"""Exports of ODK Central, KoboToolbox and QField, as they are documented, become photos of a map."""

import io
import zipfile
from dataclasses import replace

import pytest
from click.testing import CliRunner
from sqlalchemy import select

from tests.geopackages import point, write_package
from tests.street_server import picture
from tests.web.conftest import app, client, library, new_account, new_map, owner, settings, sign_in, stranger
from webapp.app.registry import REGISTRY
from webapp.connect.forms import importing
from webapp.connect.forms.command import forms
from webapp.connect.forms.importing import FormFile, GivenExport, read_export
from webapp.connect.forms.submissions import read_submissions
from webapp.errors import InputError
from webapp.jobs.kinds import Kind
from webapp.jobs.worker import Worker
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.maps import maps
from webapp.store.schema import Job, MapRecord

__all__ = ["app", "client", "library", "new_account", "new_map", "owner", "settings", "sign_in", "stranger"]
PAGE = "/account/forms"
QUICK = replace(REGISTRY, kinds={**REGISTRY.kinds, "index": Kind("tests.connect.forms.test_forms:no_index")})
CENTRAL = (
    "SubmissionDate,start,end,site-spot-Latitude,site-spot-Longitude,site-spot-Altitude,site-spot-Accuracy,"
    "site-view,site-remark,species,meta-instanceID,KEY,SubmitterID,SubmitterName,AttachmentsPresent,Status\n"
    "2026-05-01T11:00:00.000Z,2026-05-01T12:30:15.250+02:00,,50.0008,14.0001,210.0,4.5,"
    '1714557600.jpg,"by the gate, ""old""\nsecond line",oak,uuid:11,uuid:11,4,Eva,1,\n'
    "2026-05-01T11:00:00.000Z,,,,,,,1714557601.jpg,,,uuid:12,uuid:12,4,Eva,1,\n"
    "2026-05-01T11:00:00.000Z,,,,,,,lost.jpg,,,uuid:13,uuid:13,4,Eva,1,\n"
)
REPEAT = "detail,comment,PARENT_KEY,KEY\n1714557602.jpg,bark,uuid:11,uuid:11/trees[1]\n"
REMARK = 'by the gate, "old"\nsecond line'
KOBO = (
    '"start";"end";"Where";"_Where_latitude";"_Where_longitude";"_Where_altitude";"_Where_precision";"View";'
    '"View_URL";"Notes";"_id";"_uuid";"_submission_time";"_tags"\n'
    '"2026-05-01T12:30:15+02:00";"";"50.0008 14.0001 210.5 4.5";"50.0008";"14.0001";"210.5";"4.5";"a.jpg";'
    '"https://kc.example.org/media/original?media_file=eva%2Fattachments%2Fa.jpg";"wet";"7";"u-1";"";""\n'
    '"";"";"50.0007 14.0002 0 0";"";"";"";"";"a.jpg";"";"";"8";"u-2";"";""\n'
)


def no_index(_context):
    """Do nothing, instead of building an index."""


def zipped(path, **files):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


@pytest.fixture
def central(tmp_path):
    photos = {f"media/171455760{n}.jpg": picture(str(n)) for n in range(3)}
    rest = {"media/other.jpg": picture("other"), "media/voice.m4a": b"sound"}
    return zipped(
        tmp_path / "trees.zip", **{"trees.csv": CENTRAL, "trees-trees.csv": REPEAT}, **photos, **rest
    )


@pytest.fixture
def kobo(tmp_path):
    table = tmp_path / "survey.csv"
    table.write_text(KOBO, "utf-8")
    media = {f"eva/attachments/f/u-{n}/a.jpg": picture(f"k{n}") for n in (1, 2)}
    return table, zipped(tmp_path / "media.zip", **media)


@pytest.fixture
def qfield(tmp_path):
    rows = [
        (point(14.0001, 50.0008), "A", "DCIM/trees_1.jpg", 90.0, "old oak"),
        (point(14.0003, 50.0006), "B", "DCIM/none.jpg", None, None),
    ]
    package = write_package(tmp_path / "trees.gpkg", rows).read_bytes()
    files = {"p/trees.gpkg": package, "p/DCIM/trees_1.jpg": picture("q1"), "p/project.qgs": b"<qgis/>"}
    return zipped(tmp_path / "project.zip", **files)


@pytest.fixture
def read(tmp_path):
    def do(*paths, all_answers=False):
        folder = tmp_path / "read"
        folder.mkdir()
        files = [FormFile(path, path.name) for path in paths]
        given = GivenExport(files, all_answers)
        return read_export(given, folder=folder, settings=Settings(), progress=Progress())

    return do


def test_an_export_of_odk_central_is_read(read, central):
    export = read(central)
    first, second, third = sorted(export.photos, key=lambda photo: photo.name)
    assert first.name == "media/1714557600.jpg" and first.stated.position == (50.0008, 14.0001)
    assert (first.stated.accuracy_m, first.stated.taken_at) == (4.5, "2026-05-01T12:30:15")
    assert first.stated.note == REMARK
    assert (second.stated.position, second.stated.note) == (None, None)
    # a photo of a repeat is where its submission is
    assert (third.stated.position, third.stated.note) == ((50.0008, 14.0001), f"bark\n{REMARK}")
    assert export.missing == ["lost.jpg (0/trees.csv, row 4)"] and export.unnamed == ["media/other.jpg"]


def test_all_answers_become_a_note_if_wanted(read, central):
    (first, *_) = sorted(read(central, all_answers=True).photos, key=lambda photo: photo.name)
    assert first.stated.note == f"site-remark: {REMARK}\nspecies: oak"


def test_a_table_of_kobotoolbox_and_its_media_are_read(read, kobo):
    export = read(*kobo)
    assert {photo.name: photo.stated.position for photo in export.photos} == {
        "eva/attachments/f/u-1/a.jpg": (50.0008, 14.0001),
        "eva/attachments/f/u-2/a.jpg": (50.0007, 14.0002),
    }
    assert [photo.stated.note for photo in export.photos] == ["wet", None]
    assert [photo.stated.accuracy_m for photo in export.photos] == [4.5, None]
    assert export.missing == export.unnamed == []


def test_a_project_of_qfield_is_read(read, qfield):
    export = read(qfield)
    (photo,) = export.photos
    assert photo.name == "p/DCIM/trees_1.jpg" and photo.stated.position == (50.0008, 14.0001)
    assert (photo.stated.heading_deg, photo.stated.note) == (90.0, "old oak")
    assert export.missing == ["DCIM/none.jpg (0/p/trees.gpkg)"]


def test_two_questions_for_a_place_belong_to_the_photos_after_them(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("a-Latitude,a-Longitude,one,b,two\n1.5,2.5,x.jpg,3.5 4.5 0.0 2.0,y.jpg\n")
    x, y = read_submissions([table], folder=tmp_path, all_answers=False)
    assert (x.position, y.position, y.accuracy_m) == ((1.5, 2.5), (3.5, 4.5), 2.0)


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"media/a.jpg": b"x"}, "the export has no table"),
        ({"t.csv": "a,b\n1,2\n", "a.jpg": b"x"}, "no table of the export names a photo"),
        ({"t.csv": b"a\0b" * 99}, "this is not a table"),
        ({"t.gpkg": b"SQLite format 3\0" + b"x" * 99}, "cannot be read"),
        ({"../t.csv": "a"}, "the zip has a file that a map cannot have"),
        ({"t.csv": "a,photo\n" + "1," * 3000}, "the table is too large"),
    ],
)
def test_exports_that_cannot_be_used_are_refused(read, tmp_path, files, said):
    with pytest.raises(InputError) as caught:
        read(zipped(tmp_path / "bad.zip", **files))
    assert said in caught.value.message


def test_positions_off_the_earth_and_damaged_cells_are_left_out(tmp_path):
    table = tmp_path / "t.csv"
    rows = ["99.5,14.0,x.jpg,2.5", "abc,,y.jpg,-1", "1.5,nan,z.jpg,x", "1.5"]
    table.write_bytes("\r\n".join(["p-Latitude,p-Longitude,photo,p-Accuracy", *rows]).encode("utf-16"))
    found = read_submissions([table], folder=tmp_path, all_answers=True)
    assert [(one.name, one.position) for one in found] == [("x.jpg", None), ("y.jpg", None), ("z.jpg", None)]


def post(browser, slug, *paths, **fields):
    given = zip(("file", "media"), paths, strict=False)
    files = {name: (io.BytesIO(path.read_bytes()), path.name) for name, path in given}
    return browser.post(f"/api/v1/maps/{slug}/field-forms", data={**files, **fields})


@pytest.fixture
def upload(client, library, settings, park):
    """Upload an export on the page and do the job; returns it."""

    def do(*paths, **fields):
        answer = post(client, park, *paths, **fields)
        assert answer.status_code == 202, answer.text
        assert (answer.json["kind"], answer.json["map"]) == ("field-form", park)
        Worker(library, settings, registry=QUICK).run(once=True)
        with library.database.read() as session:
            return session.scalars(
                select(Job).where(Job.kind == "field-form").order_by(Job.id.desc())
            ).first()

    return do


@pytest.fixture
def photos(library):
    def read():
        with library.database.read() as session:
            return {p.name: p for p in maps.photos(session, session.scalars(select(MapRecord)).one())}

    return read


def test_an_upload_becomes_photos_with_positions_and_notes(
    upload, photos, central, qfield, library, client, kobo
):
    assert PAGE in client.get("/account").text
    result = upload(central).result
    assert {key: result[key] for key in ("added", "placed", "duplicates", "failed")} == {
        "added": 3, "placed": 2, "duplicates": 0, "failed": [],
    }  # fmt: skip
    one = photos()["1714557602.jpg"]
    assert (round(one.x_px), round(one.y_px), one.note, one.gps_accuracy_m) == (
        100,
        200,
        f"bark\n{REMARK}",
        4.5,
    )
    assert one.taken_at == "2026-05-01T12:30:15"
    # again, with a new one
    assert upload(qfield).result["added"] == 1
    again = upload(central).result
    assert (again["added"], again["duplicates"], len(photos())) == (0, 3, 4)
    assert upload(*kobo, all_answers="true").result["added"] == 2
    left = [path.name for path in library.inner.rglob("*.zip")]
    assert left == []


def test_a_killed_run_goes_on_without_a_second_photo(
    upload, photos, central, monkeypatch, client, library, settings
):
    calls = []

    def killed(*arguments, **options):
        calls.append(1)
        if len(calls) == 2:
            raise RuntimeError("killed")
        return add(*arguments, **options)

    add = importing.add_photo
    monkeypatch.setattr(importing, "add_photo", killed)
    job = upload(central)
    assert job.state == "failed" and len(photos()) == 1
    assert client.post(f"/api/v1/jobs/{job.id}/retry").status_code == 200
    Worker(library, settings, registry=QUICK).run(once=True)
    assert len(photos()) == 3


def test_a_file_that_is_no_photo_is_named_and_the_others_are_added(upload, tmp_path, photos):
    table = "view,lat,lon\na.jpg,50.0008,14.0001\nb.jpg,50.0008,14.0001\n"
    path = zipped(tmp_path / "t.zip", **{"t.csv": table, "a.jpg": b"text", "b.jpg": picture("b")})
    result = upload(path).result
    assert (result["added"], [one["name"] for one in result["failed"]]) == (1, ["a.jpg"])
    assert list(photos()) == ["b.jpg"]


def test_the_page_offers_the_maps_that_one_may_edit_and_the_route_takes_no_others(
    client, central, park, new_account, sign_in
):
    assert f'<option value="{park}">' in client.get(PAGE).text
    other = sign_in(new_account("Eva"))
    assert "There is no map yet" in other.get(PAGE).text
    assert post(other, park, central).status_code == 404
    assert post(client, "none", central).status_code == 404
    assert post(client, park).status_code == 422
    assert post(client, park, central, all_answers="perhaps").status_code == 422


def test_the_command_shows_an_export_and_adds_it(central, library, settings, park, photos, monkeypatch):
    done = CliRunner().invoke(forms, [str(central)])
    assert "media/1714557602.jpg: 50.000800 14.000100, bark / by the gate" in done.output
    assert "lost.jpg (0/trees.csv, row 4): not in the export" in done.output
    words = [str(central), "--into", park, "--library", str(settings.library)]
    if settings.database is not None:
        monkeypatch.setenv("EXPMAP_DATABASE", settings.database)
    done = CliRunner().invoke(forms, words)
    assert done.output.startswith("3 photos added, 2 of them placed; 0 were there\n"), done.exception
    assert len(photos()) == 3
