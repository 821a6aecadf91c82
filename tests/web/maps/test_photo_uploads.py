"""Upload of photos through the API, many in a request or in chunks, and download."""

import io
import mimetypes
import threading
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from PIL import Image

from webapp.errors import DiskFull
from webapp.settings import PhotoLimits, UploadLimits
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Upload
from webapp.tasks.maps import add_photo
from webapp.web.maps import api_photos

FORM = "multipart/form-data"


@pytest.fixture
def settings(settings):
    return replace(
        settings, upload=UploadLimits(chunk_mb=0.01, files_per_request=5, open_per_account=3, reserve_mb=0.0)
    )


def jpeg(seed=0, *, side=200):
    """Return a JPEG of noise, about 20 kB."""
    pixels = np.random.default_rng(seed).integers(0, 255, (side, side, 3)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG")
    return file.getvalue()


@pytest.fixture
def send(client, park):
    """Send files, (content, name), in one request."""

    def post(*files, browser=None, slug=park):
        data = {"file": [(io.BytesIO(content), name) for content, name in files]}
        answer = (browser or client).post(f"/api/v1/maps/{slug}/photos", data=data)
        answer.request.environ["wsgi.input"].close()  # a temporary file of the client if it is large
        return answer

    return post


@pytest.fixture
def photos(library, park):
    """Return the names of the photos of the map."""

    def look():
        with library.database.read() as session:
            record = session.query(MapRecord).filter_by(slug=park).one()
            return [photo.name for photo in maps.photos(session, record)]

    return look


class Sender:
    """Sends a file as a browser does."""

    def __init__(self, client, slug):
        self.client, self.url = client, f"/api/v1/maps/{slug}/uploads"

    def begin(self, data, name="a.jpg", *, size=None, fingerprint=None):
        size = len(data) if size is None else size
        given = {"name": name, "size_bytes": size, "fingerprint": fingerprint or f"{name}/{size}"}
        return self.client.post(self.url, json=given)

    def chunk(self, id, data, *, offset):
        return self.client.patch(
            f"{self.url}/{id}",
            data=data,
            headers={"Upload-Offset": str(offset)},
            content_type="application/octet-stream",
        )

    def rest(self, begun, data):
        """Send the rest of the file, and return the last response."""
        offset, answer = begun["offset"], None
        while offset < len(data):
            answer = self.chunk(begun["id"], data[offset : offset + begun["chunk_bytes"]], offset=offset)
            offset = answer.json.get("offset", len(data))
        return answer


@pytest.fixture
def sender(client, park):
    return Sender(client, park)


def left(library):
    """Return the names of files in the uploads folder."""
    return [path.name for path in library.uploads.iterdir() if path.suffix != ".lock"]


def records(library):
    with library.database.read() as session:
        return session.query(Upload).count()


def test_every_file_of_a_request_has_its_result(send, photos, library):
    answer = send(
        (jpeg(0), "a.jpg"), (b"text", "b.txt"), (b"", "c.jpg"), (jpeg(0), "again.jpg"), (jpeg(1), "d.jpg")
    )
    assert answer.status_code == 207
    good, text, empty, again, last = answer.json
    assert (good["name"], good["id"], good["placed"], good["duplicate"]) == ("a.jpg", 0, False, False)
    assert "EXIF" in good["gps_problem"]
    assert (text["name"], text["error"]["code"]) == ("b.txt", "photo_error")
    assert (text["error"]["where"], "id" in text) == ("b.txt", False)
    assert "empty" in empty["error"]["message"]
    assert (again["id"], again["duplicate"]) == (0, True)
    assert last["id"] == 1
    assert photos() == ["a.jpg", "d.jpg"]
    assert left(library) == []


def test_requests_without_files_or_with_too_many_are_refused(send, photos, client, park):
    assert send().status_code in (400, 422)
    assert send(*[(jpeg(n), f"{n}.jpg") for n in range(6)]).status_code == 400
    many = {f"field{n}": "x" for n in range(40)}
    assert client.post(f"/api/v1/maps/{park}/photos", data=many, content_type=FORM).status_code == 413
    assert photos() == []


def test_only_editors_add(send, sign_in, new_account, new_map, stranger):
    ana, ben = new_account("ana"), new_account("ben")
    slug = new_map(ana, name="Wood", shared={ben: "viewer"})
    assert send((jpeg(), "a.jpg"), browser=sign_in(ben), slug=slug).status_code == 403
    assert send((jpeg(), "a.jpg"), browser=sign_in(new_account("eve")), slug=slug).status_code == 404
    assert send((jpeg(), "a.jpg"), browser=stranger, slug=slug).status_code == 401
    assert send((jpeg(), "a.jpg"), browser=sign_in(ana), slug=slug).status_code == 207
    assert sign_in(ben).get(f"/api/v1/maps/{slug}/photos/0/thumb", buffered=True).status_code == 200
    assert (
        sign_in(new_account("eva")).get(f"/api/v1/maps/{slug}/photos/0/thumb", buffered=True).status_code
        == 404
    )


def test_every_odd_photo_has_a_result(send, shared_data, client, park):
    for path in sorted((shared_data / "odd_photos").iterdir()):
        answer = send((path.read_bytes(), path.name))
        assert answer.status_code == 207
        (result,) = answer.json
        if "error" in result:
            assert result["error"]["message"]
        else:
            picture = client.get(f"/api/v1/maps/{park}/photos/{result['id']}/thumb", buffered=True)
            width, height = Image.open(io.BytesIO(picture.data)).size
            assert max(width, height) <= 256
            assert not path.name.startswith("landscape" if width < height else "portrait_")


def test_pictures_and_the_original_come_back(send, client, park, library):
    data = jpeg(side=300)
    send((data, 'žluť "x".jpg'))
    base = f"/api/v1/maps/{park}/photos/0"
    for kind, side, mime in (("thumb", 256, "image/webp"), ("preview", 300, "image/jpeg")):
        picture = client.get(f"{base}/{kind}", buffered=True)
        assert Image.open(io.BytesIO(picture.data)).size == (side, side)
        assert picture.mimetype == mime
        assert picture.headers["Cache-Control"] == "private, max-age=31536000, immutable"
        again = client.get(
            f"{base}/{kind}", headers={"If-None-Match": picture.headers["ETag"]}, buffered=True
        )
        assert (again.status_code, again.data) == (304, b"")
    original = client.get(f"{base}/original", buffered=True)
    assert original.data == data
    assert original.headers["Content-Disposition"].startswith("attachment")
    thumb = library.map_folder(park) / "derived/previews/0-256.webp"
    former = thumb.rename(thumb.with_suffix(".jpg"))  # the name in 0.7.0
    assert client.get(f"{base}/thumb", buffered=True).status_code == 200
    assert thumb.exists() and not former.exists()


def test_no_address_leads_out(send, client, park, library, tmp_path):
    send((jpeg(), "a.jpg"))
    base = f"/api/v1/maps/{park}/photos"
    for path in (
        "0/../../x/thumb",
        "1/thumb",
        "-1/thumb",
        "%2e%2e/thumb",
        "0/secret",
        "999999999999999999999/thumb",
    ):
        assert client.get(f"{base}/{path}").status_code == 404
    secret = tmp_path / "secret.jpg"
    secret.write_bytes(jpeg(9))
    (photo,) = library.map_folder(park).glob("photos/*")
    photo.unlink()
    photo.symlink_to(secret)
    answer = client.get(f"{base}/0/original", buffered=True)
    assert answer.status_code == 422
    assert str(tmp_path) not in answer.json["error"]["message"]


def test_a_photo_missing_on_disk_is_reported(send, client, park, library):
    send((jpeg(), "a.jpg"))
    for path in (
        *library.map_folder(park).glob("photos/*"),
        *library.map_folder(park).glob("derived/previews/*"),
    ):
        path.unlink()
    for kind in ("thumb", "original"):
        answer = client.get(f"/api/v1/maps/{park}/photos/0/{kind}", buffered=True)
        assert answer.status_code in (404, 422)
        assert str(library.folder) not in answer.text


def test_a_file_comes_in_chunks(sender, photos, library):
    data = jpeg()
    assert len(data) > 20_000
    begun = sender.begin(data, "výlet.jpg")
    assert (begun.status_code, begun.json["offset"], begun.json["chunk_bytes"]) == (201, 0, 10_000)
    assert sender.chunk(begun.json["id"], data[:10_000], offset=0).json == {"offset": 10_000}
    again = sender.begin(data, "výlet.jpg").json
    assert (again["id"], again["offset"]) == (begun.json["id"], 10_000)
    result = sender.rest(again, data)
    assert result.status_code == 200
    assert (result.json["id"], result.json["name"], result.json["duplicate"]) == (0, "výlet.jpg", False)
    assert photos() == ["výlet.jpg"]
    assert (left(library), records(library)) == ([], 0)


def test_photos_are_numbered_in_the_order_in_which_they_were_begun(sender, client, park):
    data = [jpeg(seed) for seed in range(3)]
    begun = [sender.begin(content, f"IMG_{number}.JPG").json for number, content in enumerate(data)]
    for number in (2, 0, 1):
        assert sender.rest(begun[number], data[number]).json["id"] == number
    found = client.get(f"/api/v1/maps/{park}").json["photos"]
    assert {photo["id"]: photo["name"] for photo in found} == {n: f"IMG_{n}.JPG" for n in range(3)}


def test_a_chunk_that_does_not_fit_gets_the_offset_to_go_on_at(sender, client):
    data = jpeg()
    id = sender.begin(data).json["id"]
    sender.chunk(id, data[:5000], offset=0)
    for offset in (0, 4999, 6000):
        answer = sender.chunk(id, data[offset : offset + 1000], offset=offset)
        assert (answer.status_code, answer.json["offset"]) == (409, 5000)
        assert answer.headers["Upload-Offset"] == "5000"
        assert answer.json["error"]["code"] == "wrong_offset"
    assert client.get(f"{sender.url}/{id}").json["offset"] == 5000
    assert sender.rest({"id": id, "offset": 5000, "chunk_bytes": 10_000}, data).json["id"] == 0


@pytest.mark.parametrize("offset", ["", "-1", "x", "1.5", "9" * 30, "²"])
def test_a_chunk_says_where_it_belongs(sender, offset):
    id = sender.begin(jpeg()).json["id"]
    assert sender.chunk(id, b"x", offset=offset.encode("utf-8").decode("latin-1")).status_code == 400


def test_chunks_have_a_largest_size(sender, client):
    data = jpeg()
    id = sender.begin(data).json["id"]
    assert sender.chunk(id, data[:10_001], offset=0).status_code == 413
    assert client.get(f"{sender.url}/{id}").json["offset"] == 0


def test_a_file_that_is_not_a_photo_is_refused_at_the_end(sender, photos, library):
    data = jpeg()[:15_000]
    answer = sender.rest(sender.begin(data, "cut.jpg").json, data)
    assert answer.status_code == 422
    assert answer.json["error"]["where"] == "cut.jpg"
    assert (left(library), records(library), photos()) == ([], 0, [])


def test_more_than_was_announced_is_refused(sender, library):
    id = sender.begin(b"", size=10).json["id"]
    assert sender.chunk(id, b"x" * 11, offset=0).status_code == 422
    assert (left(library), records(library)) == ([], 0)


def test_what_cannot_come_in_is_refused_at_once(sender, settings, client, park):
    assert sender.begin(b"").status_code == 422
    most = int(PhotoLimits().max_mb * 1e6)
    assert sender.begin(b"", size=most + 1).status_code == 422
    good = {"name": "a", "size_bytes": 1, "fingerprint": "f"}
    wrong = ({"size_bytes": -1}, {"size_bytes": 1e99}, {"size_bytes": "1"}, {"name": 1}, {"fingerprint": ""})
    for bad in ({}, [], "x", None, *(good | w for w in wrong)):
        answer = client.post(sender.url, json=bad)
        assert 400 <= answer.status_code < 500
        assert answer.json["error"]["message"]


def test_half_done_uploads_are_few(sender):
    for number in range(3):
        assert sender.begin(b"", f"{number}.jpg", size=100).status_code == 201
    assert sender.begin(b"", "4.jpg", size=100).status_code == 400
    assert sender.begin(b"", "0.jpg", size=100).status_code == 201


def test_an_upload_is_its_owners(sender, sign_in, new_account, library, park, owner):
    data = jpeg()
    id = sender.begin(data).json["id"]
    ana = new_account("ana")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=park).one()
        accounts.set_member_role(session, record, account=ana, role="editor")
    other = Sender(sign_in(ana), park)
    assert other.chunk(id, data[:10], offset=0).status_code == 404
    assert other.begin(data).json["id"] != id
    for wrong in ("0" * 32, "..", "../../x", "%2e%2e%2f"):
        assert sender.chunk(wrong, b"x", offset=0).status_code == 404


def test_an_upload_given_up_is_deleted(sender, client, library):
    data = jpeg()
    id = sender.begin(data).json["id"]
    sender.chunk(id, data[:10_000], offset=0)
    assert client.delete(f"{sender.url}/{id}").status_code == 204
    assert (left(library), records(library)) == ([], 0)
    assert client.get(f"{sender.url}/{id}").status_code == 404


def test_killed_after_the_last_chunk_an_empty_one_completes(sender, library, monkeypatch, photos):
    data = jpeg(side=120)
    id = sender.begin(data).json["id"]

    def killed(*_positional, **_named):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(add_photo, "add_photo", killed)
        with pytest.raises(KeyboardInterrupt):
            sender.chunk(id, data, offset=0)
    assert photos() == []
    begun = sender.begin(data).json
    assert (begun["id"], begun["offset"]) == (id, len(data))
    assert sender.chunk(id, b"", offset=len(data)).json["id"] == 0


def test_killed_after_the_commit_the_file_sent_again_is_the_same_photo(sender, monkeypatch, photos, library):
    data = jpeg(side=120)
    id = sender.begin(data).json["id"]

    def killed(_upload):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(api_photos, "_give_up", killed)
        with pytest.raises(KeyboardInterrupt):
            sender.chunk(id, data, offset=0)
    begun = sender.begin(data).json
    assert (begun["id"], begun["offset"]) == (id, 0)
    again = sender.chunk(id, data, offset=0)
    assert (again.json["id"], again.json["duplicate"]) == (0, True)
    assert (photos(), left(library), records(library)) == (["a.jpg"], [], 0)


def test_a_full_disk_leaves_nothing(sender, monkeypatch, library):
    def full(*_positional, **_named):
        raise DiskFull("the disk is full")

    data = jpeg()
    begun = sender.begin(data).json
    sender.chunk(begun["id"], data[:100], offset=0)
    monkeypatch.setattr(api_photos, "append", full)
    assert sender.chunk(begun["id"], data[100:200], offset=100).status_code == 507
    assert (left(library), records(library)) == ([], 0)
    monkeypatch.setattr(api_photos, "check_space", full)
    assert sender.begin(data).status_code == 507


def test_the_same_file_from_many_at_once_is_one_photo(app, sign_in, owner, park, photos):
    data, results = jpeg(side=100), []

    def run(number):
        sender = Sender(sign_in(owner), park)
        begun = sender.begin(data, fingerprint=f"{number}").json
        results.append(sender.rest(begun, data).json)

    threads = [threading.Thread(target=run, args=(n,)) for n in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({r["id"] for r in results}) == 1, "that of the upload which came first"
    assert sorted(r["duplicate"] for r in results) == [False, True, True]
    assert photos() == ["a.jpg"]


def test_thumbs_are_named_right_also_where_the_system_has_no_list_of_types(client, park, monkeypatch):
    file = io.BytesIO()
    Image.new("RGB", (300, 200), "red").save(file, "JPEG")
    file.seek(0)
    client.post(f"/api/v1/maps/{park}/photos", data={"file": [(file, "a.jpg")]})
    monkeypatch.setattr(mimetypes, "guess_type", lambda name: (None, None))
    answer = client.get(f"/api/v1/maps/{park}/photos/0/thumb", buffered=True)
    assert (answer.status_code, answer.mimetype) == (200, "image/webp")


@pytest.mark.parametrize(
    ("maker", "model", "camera"),
    [
        ("Canon", "Canon EOS 5D", "Canon EOS 5D"),
        ("SONY \0", "ILCE-7M3", "SONY ILCE-7M3"),
        ("", "Pixel 8", "Pixel 8"),
        ("OLYMPUS CORPORATION", "", "OLYMPUS CORPORATION"),
        ("", "", None),
    ],
)
def test_the_camera_of_a_photo_is_kept(send, client, park, maker, model, camera):
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = maker, model
    file = io.BytesIO()
    Image.new("RGB", (300, 200), "red").save(file, "JPEG", exif=exif)
    send((file.getvalue(), "a.jpg"))
    (photo,) = client.get(f"/api/v1/maps/{park}").json["photos"]
    assert photo["camera"] == camera


XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    b'<r:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="50,6.0N" '
    b'exif:GPSLongitude="14,24.0E"/></r:RDF></x:xmpmeta>'
)
GOOGLE = b'{"geoData": {"latitude": 50.2, "longitude": 14.5}}'


class TestFilesBesidePhotos:
    def test_in_one_request(self, send, client, park):
        answers = send(
            (jpeg(1), "a.jpg"), (XMP, "a.jpg.xmp"), (jpeg(2), "b.jpg"), (GOOGLE, "b.jpg.suppl.json"),
            (XMP, "c.xmp"),
        ).json  # fmt: skip
        assert [one.get("belongs_to") for one in answers] == [None, "a.jpg", None, "b.jpg", None]
        assert "no photo of the request" in answers[4]["error"]["message"]
        assert [answers[n]["notes"] for n in (0, 2)] == [
            ["its position is from a.jpg.xmp"],
            ["its position is from b.jpg.suppl.json"],
        ]
        rows = client.get(f"/api/v1/maps/{park}/photos").json["photos"]
        assert [(one["gps"]["lat"], one["gps_problem"]) for one in rows] == [(50.1, None), (50.2, None)]
        assert rows[0]["file_notes"] == ["its position is from a.jpg.xmp"]

    def test_two_of_one_name_are_refused(self, send, photos):
        answer = send((jpeg(1), "a.jpg"), (XMP, "a.xmp"), (b"<a/>", "a.xmp"))
        assert (answer.status_code, answer.json["error"]["where"]) == (400, "a.xmp")
        assert photos() == []

    def test_they_have_a_limit_in_all(self, send, photos, monkeypatch):
        monkeypatch.setattr(api_photos, "_MOST_BESIDE_BYTES", 2 * len(XMP) - 1)
        answer = send((jpeg(1), "a.jpg"), (XMP, "a.jpg.xmp"), (jpeg(2), "b.jpg"), (XMP, "b.jpg.xmp"))
        assert (answer.status_code, answer.json["error"]["where"]) == (400, "b.jpg.xmp")
        assert photos() == []

    def test_with_an_upload_in_chunks(self, client, park):
        data = jpeg(3, side=40)
        sender = Sender(client, park)
        beside = [
            {"name": "other.xmp", "content": "x"},
            {"name": "a.jpg.xmp", "content": XMP.decode()},
        ]
        given = {"name": "a.jpg", "size_bytes": len(data), "fingerprint": "f", "beside": beside}
        begun = client.post(sender.url, json=given)
        assert begun.status_code == 201
        done = sender.chunk(begun.json["id"], data, offset=0).json
        assert done["notes"] == ["its position is from a.jpg.xmp"]

    @pytest.mark.parametrize(
        "beside",
        [
            [{"name": "a.xmp"}],
            [{"name": "a.xmp", "content": "x" * 150_001}],
            [{"name": "a", "content": ""}] * 4,
        ],
    )
    def test_too_much_beside_a_photo_is_refused(self, client, park, beside):
        given = {"name": "a.jpg", "size_bytes": 10, "fingerprint": "f", "beside": beside}
        assert client.post(f"/api/v1/maps/{park}/uploads", json=given).status_code == 422

    def test_what_is_odd_in_a_file_is_said(self, send):
        dark = io.BytesIO()
        Image.fromarray(np.linspace(500, 900, 1200).astype(np.uint16).reshape(30, 40)).save(dark, "PNG")
        (answer,) = send((dark.getvalue(), "dark.png")).json
        assert "contrast was stretched" in answer["notes"][0]

    def test_what_looks_like_a_plan_is_said(self, send, library, park):
        plan = io.BytesIO()
        profile = {
            "driver": "GTiff",
            "dtype": "uint8",
            "count": 1,
            "width": 40,
            "height": 30,
            "crs": "EPSG:32633",
        }
        with rasterio.open(
            plan, "w", transform=rasterio.Affine(1, 0, 458000, 0, -1, 5550000), **profile
        ) as out:
            out.write(np.zeros((1, 30, 40), np.uint8))
        with library.database.write() as session:
            record = session.query(MapRecord).filter_by(slug=park).one()
            record.satellite_path, record.satellite_width, record.satellite_height = "s.png", 200, 150
        sheet = io.BytesIO()
        Image.new("RGB", (200, 150)).save(sheet, "PNG")
        answers = send((plan.getvalue(), "a.tif"), (sheet.getvalue(), "b.png"), (jpeg(7), "c.jpg")).json
        assert ["like a plan" in " ".join(one["notes"]) for one in answers] == [True, True, False]
        assert [one["is_plan"] for one in answers] == [True, True, False]

    def test_on_a_map_without_an_image_a_drawing_may_become_it(self, send, library, park):
        sheet = io.BytesIO()
        Image.new("RGB", (300, 250), "white").save(sheet, "PNG")
        files = (sheet.getvalue(), "plan.png"), (jpeg(7), "c.jpg")
        assert [one["is_plan"] for one in send(*files).json] == [True, False]
        with library.database.write() as session:
            record = session.query(MapRecord).filter_by(slug=park).one()
            record.satellite_path, record.satellite_width, record.satellite_height = "s.png", 200, 150
        assert [one["is_plan"] for one in send(*files).json] == [False, False]
