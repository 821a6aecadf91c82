"""A satellite image is uploaded, stored and served; other files change nothing."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.web.satellite.images import CORNERS, geotiff, message, png
from webapp.files.maps.map_json import parse_georeference
from webapp.progress import Progress
from webapp.settings import SatelliteLimits, Settings
from webapp.store.schema import Job
from webapp.tasks.maps.export import export_late_maps
from webapp.tasks.satellite import display


class TestUpload:
    def test_an_image_is_set_kept_and_exported(self, put, client, base, library, park, record):
        answer = put(png(300, 200), corners=CORNERS)
        assert answer.status_code == 200, answer.text
        satellite = answer.json["satellite"]
        assert (satellite["width"], satellite["height"], satellite["tiles"]) == (300, 200, None)
        assert answer.json["georeference"]["method"] == "corners"
        assert answer.json["undo"] == {"kind": "satellite", "count": 1}
        name = record().satellite_path
        assert name.startswith("satellite-")
        assert (library.map_folder(park) / name).read_bytes() == png(300, 200)
        export_late_maps(library)
        assert library.cfg(park).read_text().startswith(f"{name};300;200")
        assert not [p for p in library.uploads.iterdir() if p.suffix != ".lock"]

        shown = client.get(satellite["url"], buffered=True)
        assert shown.data == png(300, 200)
        assert shown.mimetype == "image/png"
        assert "immutable" in shown.headers["Cache-Control"]
        assert (
            client.get(satellite["url"], headers={"If-None-Match": shown.headers["ETag"]}).status_code == 304
        )
        small = client.get(f"{base}/thumbnail", buffered=True)
        assert Image.open(io.BytesIO(small.data)).size == (300, 200)

    def test_it_can_be_undone_and_done_again(self, put, client, base, record):
        put(png(300, 200), corners=CORNERS)
        put(png(310, 200, shade=9))
        client.post(f"{base}/undo")
        assert (record().satellite_width, record().georeference["method"]) == (300, "corners")
        client.post(f"{base}/undo")
        assert record().satellite_path is None
        client.post(f"{base}/redo")
        assert client.get(f"{base}/satellite", buffered=True).data == png(300, 200)

    def test_a_heavy_png_is_shown_by_a_lighter_copy_of_the_same_size(self, put, client, base, library, park):
        noise = np.random.default_rng(0).integers(0, 255, (300, 380, 3), np.uint8)
        buffer = io.BytesIO()
        Image.fromarray(noise).save(buffer, format="PNG")
        put(buffer.getvalue())
        shown = client.get(f"{base}/satellite", buffered=True)
        assert shown.mimetype == "image/webp" and len(shown.data) < len(buffer.getvalue()) / 2
        image = Image.open(io.BytesIO(shown.data)).convert("RGB")
        assert image.size == (380, 300)
        assert abs(np.asarray(image, float).mean() - noise.mean()) < 5
        assert next(library.map_folder(park).glob("satellite-*.png")).read_bytes() == buffer.getvalue()

    def test_a_geotiff_brings_its_place(self, put, record):
        answer = put(geotiff(), name="photo.jpg")
        assert answer.status_code == 200, answer.text
        assert parse_georeference(record().georeference).plane == "EPSG:32633"
        assert record().satellite_path.endswith(".png")
        assert answer.json["warnings"] == []

    def test_a_tiff_of_no_use_for_that_is_still_an_image(self, put, record):
        answer = put(png(30, 20, kind="TIFF"), name="plain.tif")
        assert answer.json["warnings"] == ["the TIFF has no georeference"]
        assert record().georeference is None

    @pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
    def test_an_image_on_its_side_is_turned(self, client, base, put, record, kind):
        exif = Image.Exif()
        exif[0x0112] = 6
        said = put(png(300, 200, kind=kind, exif=exif)).json["warnings"]
        assert said[-1] == "it was turned by its EXIF orientation 6, to 200 x 300 pixels"
        assert (record().satellite_width, record().satellite_height) == (200, 300)
        shown = Image.open(io.BytesIO(client.get(f"{base}/satellite", buffered=True).data)).convert("RGB")
        assert shown.size == (200, 300)
        assert np.abs(np.subtract(shown.getpixel((199, 1)), (1, 0, 120))).max() < 12, (
            "the corner that was at the top left"
        )

    def test_a_world_file_says_where(self, put, record):
        text = b"0.5\n0\n0\n-0.5\n500000.25\n5539999.75\n"
        answer = put(png(60, 40), worldfile=text.decode())
        assert answer.status_code == 422, "a world file is a file"

    @pytest.mark.parametrize(
        ("data", "why"),
        [
            (b"", "empty"),
            (b"<svg/>", "not a PNG, JPEG or TIFF"),
            (png(20, 20, kind="GIF")[:60], ""),
            (png(300, 200)[:400], "damaged, truncated"),
            (png(300, 200, kind="JPEG")[:3000], "damaged, truncated"),
            (png(300, 200, kind="TIFF")[:9000], "damaged, truncated"),
            (b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR\0\1\0\0\0\1\0\0" + bytes(40), ""),
        ],
    )
    def test_what_is_no_image_changes_nothing(self, put, record, library, park, data, why):
        assert why in message(put(data), 422)
        assert record().revision == 0
        assert not library.map_folder(park).exists()
        assert not [p for p in library.uploads.iterdir() if p.suffix != ".lock"]

    @pytest.mark.parametrize(
        "corners",
        ["no json", "[]", '{"top_left": 3, "bottom_right": 4}', json.dumps({"top_left": {"lat": 1}})],
    )
    def test_wrong_corners_change_nothing(self, put, record, corners):
        assert put(png(30, 20), corners=corners).status_code == 422
        assert record().revision == 0

    def test_no_path_from_the_client_counts(self, put, record, library):
        for name in ("../../evil.png", "/etc/passwd", "a\0b.png", "x" * 5000):
            assert put(png(30, 20), name=name).status_code == 200
        assert record().satellite_path.startswith("satellite-")
        assert not (library.folder.parent / "evil.png").exists()

    def test_who_may_only_look_cannot_set_it(
        self, put, new_account, sign_in, library, record, stranger, base
    ):
        assert put(png(30, 20), who=sign_in(new_account("Jan"))).status_code == 404
        assert stranger.get(f"{base}/satellite").status_code == 401

    def test_nothing_where_there_is_none(self, client, base):
        for what in ("satellite", "thumbnail", "satellite/tiles/0/0/0"):
            assert client.get(f"{base}/{what}").status_code == 404


class TestLargeImages:
    def test_they_get_tiles(self, put, client, base, library, record):
        answer = put(png(4200, 300))
        satellite = answer.json["satellite"]
        assert satellite["tiles"] is None, "not before the job has run"
        shown = Image.open(io.BytesIO(client.get(satellite["url"], buffered=True).data))
        assert shown.format == "JPEG"
        assert shown.width <= 2048
        with library.database.read() as session:
            assert [job.kind for job in session.query(Job)] == ["satellite-pyramid"]
        display.make_tiles(library, record().id, settings=Settings(), progress=Progress())
        tiles = client.get(base).json["satellite"]["tiles"]
        assert tiles["max_zoom"] == 5
        tile = client.get(tiles["url"].format(z=5, x=3, y=0), buffered=True)
        assert tile.mimetype == "image/jpeg"
        edge = client.get(tiles["url"].format(z=5, x=16, y=1), buffered=True)
        assert edge.mimetype == "image/webp"
        assert client.get(tiles["url"].format(z=5, x=17, y=0), buffered=True).status_code == 404

    def test_the_limits_count(self, put, app, library, settings):
        app.extensions["expmap"] = replace(
            app.extensions["expmap"],
            settings=Settings(library=settings.library, satellite=SatelliteLimits(max_megapixels=0.05)),
        )
        assert "megapixels, more than the limit" in message(put(png(300, 200)), 422)


def test_images_are_taken_one_after_the_other(put, app, library):
    """Each may keep a core busy for long, and waiting ones would block threads."""
    permits = app.extensions["expmap_concurrency"]["satellite images"]
    assert permits.acquire(blocking=False) and not permits.acquire(blocking=False)
    answer = put(png(30, 20))
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "1")
    assert list(library.uploads.iterdir()) == []
    permits.release()
    assert put(png(30, 20)).status_code == 200
