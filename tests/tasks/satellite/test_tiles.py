"""An area exported from a local tile service: corners and landmarks are correct to a pixel."""

import json
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from PIL import Image

from tests.tile_server import global_pixel, serving
from webapp.core.geo.tilegrid import GeoBox
from webapp.errors import Cancelled, GeoreferenceError, InputError, NotFound, UsageError
from webapp.files.maps.map_json import parse_georeference
from webapp.jobs.context import Context, JobProgress
from webapp.jobs.map_jobs import fetch_satellite_tiles as run_job
from webapp.progress import Progress
from webapp.settings import Settings, TileSettings
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.schema import Account, Job, MapRecord
from webapp.tasks.satellite import tiles as satellite_tiles
from webapp.tasks.satellite.files import source_of
from webapp.tasks.satellite.tiles import TileRequest

LANDMARKS = [(50.0765, 14.4164), (50.0771, 14.4187), (50.0779, 14.4172)]
BOX = GeoBox(north=50.0783, south=50.0760, west=14.4155, east=14.4196)


@pytest.fixture
def server():
    with serving() as tiles:
        tiles.landmarks = LANDMARKS
        yield tiles


@pytest.fixture
def settings(server, tmp_path):
    services = tmp_path / "services.json"
    one = {"name": "Local", "url": server.url, "attribution": "© this test", "max_zoom": 19, "max_tiles": 200}
    services.write_text(json.dumps([one]))
    return Settings(tile_services=services, tiles=TileSettings(requests_per_second=1000.0, timeout_s=5.0))


@pytest.fixture
def library(tmp_path):
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


@pytest.fixture
def map_id(library):
    with library.database.write() as session:
        account = Account(name="Eva", is_owner=True)
        session.add(account)
        session.flush()
        return maps.create(session, "Park", account_id=account.id).id


@pytest.fixture
def fetch(library, map_id, settings):
    def run(box=BOX, zoom=17, service="Local", progress=None):
        wish = TileRequest(service, box, zoom)
        return satellite_tiles.fetch_tiles(
            library, map_id, request=wish, settings=settings, progress=progress or Progress()
        )

    return run


def pixels_of(library, name):
    return np.asarray(Image.open(library.map_folder("park") / name).convert("RGB")).astype(int)


def crosses(pixels):
    """Return the centres of the red crosses."""
    red = (pixels[:, :, 0] > 200) & (pixels[:, :, 1] < 60) & (pixels[:, :, 2] < 60)
    middles = [
        (x, y)
        for y, x in zip(*np.nonzero(red), strict=True)
        if red[max(y - 3, 0) : y + 4, x].sum() == 7 and red[y, max(x - 3, 0) : x + 4].sum() == 7
    ]
    return sorted(middles)


@pytest.mark.parametrize("zoom", [17, 19])
def test_corners_and_landmarks_are_right_to_a_pixel(fetch, library, zoom):
    new = fetch(zoom=zoom).new
    image = new.image
    pixels = pixels_of(library, new.path)
    assert pixels.shape == (image.height, image.width, 3)

    north_west = image.georeference.latlon_from_pixel([(0, 0)])[0]
    south_east = image.georeference.latlon_from_pixel([(image.width, image.height)])[0]
    degrees_a_pixel = 360 / 256 / 2**zoom
    assert north_west == pytest.approx((BOX.north, BOX.west), abs=0.51 * degrees_a_pixel)
    assert south_east == pytest.approx((BOX.south, BOX.east), abs=0.51 * degrees_a_pixel)

    at = image.georeference.pixel_from_latlon(LANDMARKS)
    # the pixel that contains the place is the centre of the cross
    assert crosses(pixels) == sorted((int(x), int(y)) for x, y in np.floor(at).tolist())


def test_twice_the_zoom_is_twice_the_size(fetch):
    small, large = fetch(zoom=17).new.image, fetch(zoom=18).new.image
    assert abs(large.width - 2 * small.width) <= 2
    assert abs(large.height - 2 * small.height) <= 2


def test_nothing_is_resampled_and_photos_are_kept_as_jpeg(fetch, library, server):
    server.format = "JPEG"
    new = fetch().new
    assert new.path.endswith(".jpg")
    x, y = global_pixel(BOX.north, BOX.west, 17)
    tile = (x + 50) // 256, (y + 50) // 256
    expected = np.array([60 + 40 * (tile[0] % 3), 120, 60 + 40 * (tile[1] % 3)])
    assert np.abs(pixels_of(library, new.path)[50, 50] - expected).max() < 8


def test_a_missing_tile_is_grey_and_reported(fetch, library, server):
    x, y = global_pixel(*LANDMARKS[0], 17)
    server.missing = {(17, x // 256, y // 256)}
    fetched = fetch()
    assert fetched.missing == 1
    assert "1 of" in fetched.warnings[0]
    col, row = (int(v) for v in fetched.new.image.georeference.pixel_from_latlon([LANDMARKS[0]])[0])
    assert (pixels_of(library, fetched.new.path)[row, col] == 204).all()
    assert source_of(library.map_folder("park"), fetched.new.path)["missing_tiles"] == 1


def test_an_area_without_any_tile_is_an_error(fetch, server, library):
    server.status = 404
    with pytest.raises(InputError, match="no image of this area"):
        fetch()
    assert not library.map_folder("park").exists()


def test_the_attribution_is_kept_next_to_the_image(fetch, library):
    new = fetch().new
    source = source_of(library.map_folder("park"), new.path)
    assert source["attribution"] == "© this test"
    assert source["zoom"] == 17
    assert source["box"]["north"] == BOX.north


class TestPoliteness:
    def test_tiles_are_fetched_once(self, fetch, server):
        fetch()
        first = dict(server.asked)
        fetch()
        assert dict(server.asked) == first
        assert set(first.values()) == {1}

    def test_it_says_who_it_is_and_asks_for_few_at_once(self, fetch, server):
        server.delay_s = 0.02
        fetch(zoom=18)
        assert server.most_at_once <= 4
        assert all(agent.startswith("experience-map/") for agent in server.agents)

    def test_a_busy_service_is_asked_again(self, fetch, server, settings):
        x, y = global_pixel(*LANDMARKS[0], 17)
        server.failing[f"/17/{x // 256}/{y // 256}"] = 2
        assert fetch().missing == 0
        assert server.asked[f"/17/{x // 256}/{y // 256}"] == 3

    def test_stopped_work_continues_where_it_was(self, fetch, server):
        class Stop(Progress):
            done = 0

            def advance(self, steps=1):
                self.done += steps

            def cancelled(self):
                return self.done >= 4

        with pytest.raises(Cancelled):
            fetch(zoom=18, progress=Stop())
        fetch(zoom=18)
        # at most the pending requests were in vain
        assert sum(server.asked.values()) <= len(server.asked) + 6


class TestRefused:
    def test_too_many_tiles(self, fetch, server):
        with pytest.raises(UsageError, match="tiles at zoom 19, but only 200 are allowed"):
            fetch(box=GeoBox(north=50.2, south=50.0, west=14.0, east=14.3), zoom=19)
        assert not server.asked

    def test_a_zoom_that_the_service_has_not(self, fetch):
        with pytest.raises(UsageError, match="no zoom 20"):
            fetch(zoom=20)

    def test_a_service_that_is_not_configured(self, fetch):
        with pytest.raises(NotFound, match="unknown tile service"):
            fetch(service="http://127.0.0.1/")

    def test_a_service_that_cannot_be_reached(self, library, map_id, settings, tmp_path):
        services = json.loads(settings.tile_services.read_text())
        settings.tile_services.write_text(
            json.dumps([{**services[0], "url": "http://127.0.0.1:1/{z}/{x}/{y}.png"}])
        )
        wish = TileRequest("Local", BOX, 17)
        with pytest.raises(InputError) as failed:
            satellite_tiles.fetch_tiles(library, map_id, request=wish, settings=settings, progress=Progress())
        assert failed.value.message == "Local cannot be reached"

    def test_no_area(self, fetch):
        with pytest.raises(GeoreferenceError, match="empty"):
            fetch(box=GeoBox(north=50.0, south=50.1, west=14.0, east=14.3))

    @pytest.mark.parametrize(
        ("wrong", "why"),
        [
            ({"status": 403}, "answered 403"),
            ({"status": 302}, "answered 302"),
            ({"body": b"<html>no key</html>"}, "did not send a tile"),
            ({"body": b"\x89PNG\r\n\x1a\n" + bytes(50)}, "damaged tile"),
            ({"body": b"\xff\xd8\xff" + bytes(5_000_000)}, "did not send a tile"),
            ({"size": 512}, "512 x 512 pixels"),
        ],
    )
    def test_what_is_no_tile(self, fetch, server, wrong, why):
        for name, value in wrong.items():
            setattr(server, name, value)
        with pytest.raises(InputError, match=why):
            fetch()


def test_the_job_gives_the_map_its_image(library, map_id, settings):
    arguments = {"service": "Local", "zoom": 17, **BOX._asdict()}
    with library.database.write() as session:
        jobs.enqueue(session, "satellite-tiles", map_id=map_id, arguments=arguments)
        job = jobs.lease(session, "test", limits=jobs.Limits(seconds=60, attempts=3))
        lease = jobs.Lease(job.id, job.fence)
    progress = JobProgress()
    context = Context(library, settings, progress, lease, map_id, None, arguments)
    result = run_job(context)
    done, total, _ = progress.state()
    assert done == total == result["tiles"]
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        assert (record.satellite_width, record.satellite_height) == (result["width"], result["height"])
        assert parse_georeference(record.georeference).plane == "EPSG:3857"
        assert session.get(Job, job.id).state == "running"
        revision = record.revision
    assert run_job(context)["tiles"] == result["tiles"]
    with library.database.read() as session:
        assert session.get(MapRecord, map_id).revision == revision, "done again, it changes nothing"


def test_a_file_of_tiles_needs_no_network(library, map_id, server, settings, tmp_path):
    box = BOX
    cut = satellite_tiles.cut_of(box, 17)
    with closing(sqlite3.connect(tmp_path / "park.mbtiles")) as database:
        database.execute("CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data BLOB)")
        for tile, _, _ in cut.tiles():
            row = (17, tile.x, (1 << 17) - 1 - tile.y, server.draw(17, tile.x, tile.y))
            database.execute("INSERT INTO tiles VALUES (?, ?, ?, ?)", row)
        database.commit()
    services = [{"name": "Own", "file": "park.mbtiles", "attribution": "© us", "max_zoom": 17}]
    settings.tile_services.write_text(json.dumps(services))
    request = TileRequest("Own", box, 17)
    found = satellite_tiles.fetch_tiles(
        library, map_id, request=request, settings=settings, progress=Progress()
    )
    assert (found.missing, found.attribution, server.asked.total()) == (0, "© us", 0)
    folder = library.map_folder("park")
    pixels = np.asarray(Image.open(folder / found.new.path).convert("RGB")).astype(int)
    for lat, lon in LANDMARKS:
        x, y = (
            value - edge for value, edge in zip(global_pixel(lat, lon, 17), (cut.left, cut.top), strict=True)
        )
        assert tuple(pixels[y, x]) == (255, 0, 0)


def test_a_tile_can_be_named_by_its_area(settings):
    one = {"name": "Own", "attribution": "© us", "max_zoom": 17}
    for name, wanted in (
        ("bbox", (0.0, 10018754.1714, 10018754.1714, 20037508.3428)),
        ("bbox-4326", (66.5132604431, 0.0, 85.0511287798, 90.0)),
    ):
        settings.tile_services.write_text(json.dumps([{**one, "url": f"https://a.example/{{{name}}}"}]))
        (service,) = satellite_tiles.tile_services(settings.tile_services)
        bounds = service.address(z=2, x=2, y=0).removeprefix("https://a.example/").split(",")
        assert [float(number) for number in bounds] == pytest.approx(wanted, abs=1e-4)


def test_a_service_has_an_address_or_a_file_that_exists(settings):
    one = {"name": "Own", "attribution": "© us", "max_zoom": 17}
    url = "https://a.example/{z}/{x}/{y}"
    for fields, message in (
        ({}, "missing"),
        ({"file": "x.mbtiles", "url": url}, "invalid"),
        ({"file": "missing.mbtiles"}, "does not exist"),
        ({"url": "https://a.example/{bbox}/{z}"}, "or {bbox} or {bbox-4326}"),
        ({"url": "https://a.example/{bbox}/{bbox-4326}"}, "or {bbox} or {bbox-4326}"),
    ):
        settings.tile_services.write_text(json.dumps([{**one, **fields}]))
        with pytest.raises(UsageError, match=message):
            satellite_tiles.tile_services(settings.tile_services)
