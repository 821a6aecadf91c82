"""Placing many photos at once: by GPS, by a list of names, by a track; each undone in one step."""

import io
import math
from datetime import UTC, datetime, timedelta

import pytest
from PIL import Image

from tests.geopackages import point, write_package
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import EnuMetres, LatLon
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.store.accounts import accounts
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.export import export_late_maps

HERE = LatLon(50.08, 14.42)
NOON = datetime(2026, 5, 1, 12, 0, 0)


def latlon(east, north):
    return LocalFrame(HERE).latlon_of(EnuMetres(east, north))


def photo(number, *, at=None, taken_at=NOON):
    """Return a unique JPEG, optionally with a GPS position in metres and a time."""
    tags = CameraTags(taken_at=taken_at, focal_35mm=26, position=None if at is None else latlon(*at))
    file = io.BytesIO()
    colour = (20 * number, 0, 0)
    Image.new("RGB", (40, 30), colour).save(file, "JPEG", exif=exif_bytes(tags))
    return file.getvalue()


class Park:
    """A map of 1000 x 800 pixels, 0.1 m each, north up, its middle at HERE."""

    def __init__(self, client, library, slug):
        self.client, self.library, self.url = client, library, f"/api/v1/maps/{slug}"
        self.slug = slug

    def image(self, *, georeference=True):
        rows = [[0.1, 0.0, -50.0], [0.0, -0.1, 40.0], [0.0, 0.0, 1.0]]
        Image.new("RGB", (1000, 800)).save(self.library.map_folder(self.slug) / "plan.png")
        with self.library.database.write() as session:
            record = self.record(session)
            record.satellite_path, record.satellite_width, record.satellite_height = "plan.png", 1000, 800
            if georeference:
                plane = LocalFrame(HERE).plane
                record.georeference = {"plane": plane, "plane_from_pixel": rows, "method": "corners"}

    def record(self, session):
        return session.query(MapRecord).filter_by(slug=self.slug).one()

    def add(self, data, name):
        return self.client.post(f"{self.url}/photos", data={"file": (io.BytesIO(data), name)}).json[0]

    def post(self, path, content=None, name="list.csv", **fields):
        data = dict(fields)
        if content is not None:
            content = content.encode() if isinstance(content, str) else content
            data["file"] = (io.BytesIO(content), name)
        return self.client.post(f"{self.url}/{path}", data=data, content_type="multipart/form-data")

    def places(self):
        """Return position and heading of each photo by name."""
        with self.library.database.read() as session:
            rows = maps.photos(session, self.record(session))
            return {p.name: p.x_px and (round(p.x_px, 1), round(p.y_px, 1), p.heading_deg) for p in rows}

    def undo(self, account):
        with self.library.database.write() as session:
            return edits.undo(session, self.record(session), account_id=account.id).edit.kind


@pytest.fixture
def map_(client, library, park):
    library.map_folder(park).mkdir()
    return Park(client, library, park)


def test_photos_are_placed_by_gps_at_once_or_later(map_, owner):
    assert map_.add(photo(1, at=(1, 2)), "a.jpg")["placed"] is False
    assert map_.post("photos/place-by-gps").status_code == 400
    map_.image()
    second = map_.add(photo(2, at=(-10, 0)), "b.jpg")
    assert second["placed"] and second["job"]
    far = map_.add(photo(3, at=(900, 0)), "far.jpg")
    assert not far["placed"] and "beyond the right edge" in far["gps_problem"] and far["job"] is None
    answer = map_.post("photos/place-by-gps")
    assert answer.status_code == 200
    assert answer.json["placed"] == [0]
    assert [o["name"] for o in answer.json["outside"]] == ["far.jpg"]
    assert answer.json["job"] == second["job"]
    assert map_.places() == {"a.jpg": (510, 380, None), "b.jpg": (400, 400, None), "far.jpg": None}
    export_late_maps(map_.library)
    assert "0;photos/a.jpg;510;380\n" in map_.library.cfg("park").read_text()
    assert map_.undo(owner) == "place-gps"
    assert map_.places()["a.jpg"] is None


def test_positions_by_name_are_one_edit(map_, owner):
    map_.image(georeference=False)
    for number, name in enumerate(["walk/IMG_1.JPG", "IMG_2.jpg", "x/same.jpg", "y/same.jpg", "extra.jpg"]):
        map_.add(photo(number), name)
    lines = [
        "photos/img_1.jpg;10.5;20;",
        "IMG_2.jpg;30;40;90",
        "same.jpg;1;1;",
        "extra.jpg;5000;1;",
        "no.jpg;1;1;",
    ]
    table = "\n".join(["name;x;y;heading_deg", *lines])
    answer = map_.post("positions", table)
    assert answer.status_code == 200
    result = answer.json
    assert result["placed"] == [0, 1]
    assert (result["unknown"], result["ambiguous"], result["missing"]) == (["no.jpg"], ["same.jpg"], 2)
    assert (
        result["outside"][0]["name"] == "extra.jpg"
        and "beyond the right edge" in result["outside"][0]["reason"]
    )
    assert map_.places()["walk/IMG_1.JPG"] == (10.5, 20, None)
    assert map_.places()["IMG_2.jpg"] == (30, 40, 90)
    assert map_.undo(owner) == "place-file"
    assert set(map_.places().values()) == {None}


def test_a_geopackage_of_qfield_gives_places_headings_and_notes(map_, owner, tmp_path):
    map_.image()
    for number in range(2):
        map_.add(photo(number), f"points_{number}.jpg")
    map_.client.patch(f"{map_.url}/experiences/1", json={"note": "Ours."})
    rows = [
        (point(*latlon(-10, 0)[::-1]), "Gate", "DCIM/points_0.jpg", 90.0, "New hinge"),
        (point(*latlon(0, 10)[::-1]), "Pond", "DCIM/points_1.jpg", None, "Theirs."),
    ]
    content = write_package(tmp_path / "a.gpkg", rows).read_bytes()
    answer = map_.post("positions", content, "a.gpkg")
    assert (answer.status_code, answer.json["placed"]) == (200, [0, 1])
    assert map_.places() == {"points_0.jpg": (400, 400, 90), "points_1.jpg": (500, 300, None)}
    with map_.library.database.read() as session:
        notes = [photo.note for photo in maps.photos(session, map_.record(session))]
    assert notes == ["New hinge", "Ours."]
    assert map_.undo(owner) == "place-file"
    refused = map_.post("positions", content[:3000], "a.gpkg")
    assert (refused.status_code, refused.json["error"]["where"]) == (422, "a.gpkg")


def test_a_list_is_looked_at_first_and_moves_what_is_placed_only_if_wanted(map_):
    map_.image()
    for number in range(3):
        map_.add(photo(number), f"IMG_{number}.jpg")
    map_.post("positions", "name;x;y\nIMG_0.jpg;100;100\nIMG_1.jpg;50;50\n")
    before = map_.places()
    points = [("IMG_0", 105, 100), ("IMG_1.jpg", 50, 50), ("IMG_2.jpg", 7, 8)]
    table = "file,x [px],y [px]\n" + "".join(f"{name},{x},{y}\n" for name, x, y in points)
    seen = map_.post("positions?preview=1", table).json
    assert (seen["placed"], map_.places()) == ([], before)
    assert [(one["id"], one["moves"], one["from_px"]) for one in seen["photos"]] == [
        (0, True, [100, 100]),
        (1, False, [50, 50]),
        (2, False, None),
    ]
    moved = seen["photos"][0]
    assert (moved["moved_px"], moved["moved_m"]) == pytest.approx((5, 0.5), rel=1e-3)
    assert map_.post("positions", table, move_placed="false").json["placed"] == [2]
    assert map_.places() == {**before, "IMG_2.jpg": (7, 8, None)}
    assert map_.post("positions", table).json["placed"] == [0, 1, 2]
    assert map_.places()["IMG_0.jpg"] == (105, 100, None)


def test_columns_of_a_list_are_given(map_):
    map_.image()
    map_.add(photo(1), "a.jpg")
    refused = map_.post("positions?preview=1", "was;wo;auch\na.jpg;3;4\n")
    assert refused.status_code == 422 and "name=File" in refused.json["error"]["hint"]
    fields = {"columns": "name=was, x=2, y=3"}
    assert map_.post("positions", "was;wo;auch\na.jpg;3;4\n", **fields).json["placed"] == [0]
    assert map_.places()["a.jpg"] == (3, 4, None)


def test_positions_come_from_a_cfg_also_the_maps_own(map_):
    map_.image()
    map_.add(photo(1), "a.jpg")
    with map_.library.database.read() as session:
        path = maps.photos(session, map_.record(session))[0].path
    assert map_.post("positions", f"plan.png;1000;800\n7;{path};70;80\n", "map.cfg").json["placed"] == [0]
    assert map_.places()["a.jpg"] == (70, 80, None)
    assert map_.post("positions", "plan.png;1000;800\n7;photos/A.JPG;1;2\n", "My Map.CFG").json["placed"] == [
        0
    ]
    assert map_.places()["a.jpg"] == (1, 2, None)
    other = map_.post("positions", "plan.png;99;80\n7;a.jpg;1;2\n", "map.cfg")
    assert (other.status_code, "99 x 80" in other.json["error"]["message"]) == (400, True)


def test_positions_in_degrees_need_a_georeference(map_):
    map_.image(georeference=False)
    map_.add(photo(1), "a.jpg")
    lat, lon = latlon(10, 10)
    table = f"name;lat;lon\na.jpg;{lat:.9f};{lon:.9f}\n"
    assert map_.post("positions", table).status_code == 400
    map_.image()
    assert map_.post("positions", table).json["placed"] == [0]
    assert map_.places()["a.jpg"] == (600, 300, None)


@pytest.mark.parametrize(
    ("content", "name", "where"),
    [
        ("hello", "../x.csv", "../x.csv:1"),
        ("name;x;y\na;b;c\n", "t.csv", "t.csv:2"),
        ("name;x;y;heading_deg\na;1;1;400\n", "t.csv", "t.csv:2"),
        ("", "m.cfg", "m.cfg"),
        ("plan.png;1;1\n0;a.jpg;x;1\n", "m.cfg", "m.cfg:2"),
        (b"\xff\xfe\x00", "t.csv", "t.csv"),
    ],
)
def test_a_bad_list_is_reported_with_its_line(map_, content, name, where):
    map_.image()
    answer = map_.post("positions", content, name)
    assert answer.status_code == 422
    error = answer.json["error"]
    assert error["where"].startswith(where)
    assert str(map_.library.folder) not in answer.text
    assert [p for p in map_.library.uploads.iterdir() if p.suffix != ".lock"] == []


def track(*, start=NOON, points=11):
    """Return a walk to the east from the middle of the map, at 1 m/s with a fix every 10 s."""
    rows = []
    for number in range(points):
        lat, lon = latlon(10 * number / 5, 0)
        time = (start.replace(tzinfo=UTC) + timedelta(seconds=10 * number)).isoformat()
        rows.append(f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><time>{time}</time></trkpt>')
    return f"<gpx version='1.1'><trk><trkseg>{''.join(rows)}</trkseg></trk></gpx>"


def test_a_track_is_looked_at_first_and_then_places(map_, owner):
    map_.image()
    map_.add(photo(1, taken_at=NOON + timedelta(seconds=15)), "a.jpg")
    map_.add(photo(2, taken_at=NOON + timedelta(hours=1)), "late.jpg")
    seen = map_.post("gpx?preview=1", track(), "walk.gpx").json
    assert (seen["placed"], [p["name"] for p in seen["photos"]]) == ([], ["a.jpg"])
    assert (seen["photos"][0]["x_px"], seen["photos"][0]["y_px"]) == pytest.approx((530, 400), abs=0.1)
    assert seen["unmatched"] == [
        {"id": 1, "name": "late.jpg", "reason": "it was taken 58 min after the track ends"}
    ]
    assert (seen["fixes"], seen["ends_s"] - seen["begins_s"], seen["suggested"]) == (11, 100, None)
    assert map_.places()["a.jpg"] is None
    done = map_.post("gpx", track(), "walk.gpx").json
    assert done["placed"] == [0] and done["job"]
    assert map_.places() == {"a.jpg": (530, 400, None), "late.jpg": None}
    assert map_.undo(owner) == "place-gpx"
    assert map_.places()["a.jpg"] is None


@pytest.mark.parametrize(
    ("zone", "shift_h"), [("+02:00", -2), ("Europe/Prague", -2), ("UTC", 0), ("-0330", 3.5)]
)
def test_photos_times_have_a_zone_and_an_offset(map_, zone, shift_h):
    map_.image()
    map_.add(photo(1), "a.jpg")
    start = NOON + timedelta(hours=shift_h)
    seen = map_.post("gpx?preview=true", track(start=start), offset_s="20", time_zone=zone).json
    assert seen["photos"][0]["x_px"] == pytest.approx(540, abs=0.1)


@pytest.mark.parametrize("zone", ["Europe/Prague", "-05:00", "+14:00"])
def test_a_clock_that_was_never_set_is_no_failure(map_, zone):
    map_.image()
    for number, year in enumerate((1, 9999)):
        map_.add(
            photo(number, at=(0, 900), taken_at=NOON.replace(year=year, month=1, day=1, hour=0)),
            f"{year}.jpg",
        )
    seen = map_.post("gpx?preview=1", track(), time_zone=zone)
    assert seen.status_code == 200
    assert len(seen.json["unmatched"]) == 2


def test_the_offset_of_the_clock_is_suggested(map_):
    for number, second in enumerate((20, 50, 80)):
        taken = NOON + timedelta(seconds=second - 300)
        map_.add(photo(number, at=(second / 5, 0), taken_at=taken), f"{number}.jpg")
    map_.image()
    suggested = map_.post("gpx?preview=1", track(), max_gap_s="10").json["suggested"]
    assert suggested["offset_s"] == pytest.approx(300, abs=1)
    assert suggested["median_m"] < 1


@pytest.mark.parametrize(
    "fields",
    [{"offset_s": "nan"}, {"offset_s": "1e300"}, {"max_gap_s": "0"}, {"max_gap_s": "-5"}, {"max_gap_s": "x"},
     {"time_zone": "Middle/Earth"}, {"time_zone": "../../etc/passwd"}, {"time_zone": "\0"},
     {"time_zone": "+99:00"}, {"time_zone": "x" * 5000}],
)  # fmt: skip
def test_bad_clocks_are_refused(map_, fields):
    map_.image()
    answer = map_.post("gpx?preview=1", track(), **fields)
    assert 400 <= answer.status_code < 500
    assert answer.json["error"]["message"]


@pytest.mark.parametrize("content", ["", "<gpx/>", "<!DOCTYPE x><gpx/>", "<gpx>" * 100, b"\xff\xd8\xff"])
def test_a_file_without_a_track_is_reported(map_, content):
    map_.image()
    answer = map_.post("gpx", content, "walk.gpx")
    assert (answer.status_code, answer.json["error"]["where"]) == (422, "walk.gpx")


def test_a_track_needs_a_georeference_and_a_file(map_):
    assert map_.post("gpx", track()).status_code == 400
    map_.image(georeference=False)
    assert map_.post("gpx", track()).status_code == 400
    for path in ("gpx", "positions"):
        assert map_.post(path).status_code == 422


def test_only_editors_place(map_, sign_in, new_account, library, park):
    map_.image()
    ben = new_account("ben")
    with library.database.write() as session:
        accounts.set_member_role(session, map_.record(session), account=ben, role="viewer")
    map_.client = sign_in(ben)
    for path, content in (("photos/place-by-gps", None), ("positions", "name;x;y\n"), ("gpx", track())):
        assert map_.post(path, content).status_code == 403


def test_a_broken_world_does_not_break_placing(map_):
    """A georeference that sends photos beyond its horizon leaves them in the tray."""
    map_.add(photo(1, at=(30, 40)), "a.jpg")
    map_.image()
    rows = [[0.1, 0.0, -50.0], [0.0, -0.1, 40.0], [0.0, 0.01, -1.0]]
    with map_.library.database.write() as session:
        record = map_.record(session)
        record.georeference = {**record.georeference, "plane_from_pixel": rows}
    answer = map_.post("photos/place-by-gps")
    assert answer.status_code == 200
    assert all(o["reason"] for o in answer.json["outside"])
    assert not any(isinstance(v, float) and math.isnan(v) for v in map_.places().values())
