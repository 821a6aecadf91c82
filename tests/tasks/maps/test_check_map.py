"""The linter of maps, on folders with real image files."""

import json
import math
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import piexif
import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.places import MapPlaces
from webapp.core.mapmodel.findings import Code, Finding
from webapp.core.mapmodel.model import Experience, Map, Placement, SatelliteImage
from webapp.errors import Cancelled, MapError
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.tasks.maps import check_map

GOOD = b"s.png;40;30\n0;p/a.jpg;20;20\n1;p/b.png;5;6\n"


def picture(kind: str = "JPEG", size: tuple[int, int] = (64, 48)) -> bytes:
    """Write an image file with enough data to be truncated."""
    image = Image.radial_gradient("L").resize(size).convert("RGB")
    out = BytesIO()
    image.save(out, kind)
    return out.getvalue()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A map without faults."""
    (tmp_path / "p").mkdir()
    (tmp_path / "s.png").write_bytes(picture("PNG", (40, 30)))
    (tmp_path / "p" / "a.jpg").write_bytes(picture())
    (tmp_path / "p" / "b.png").write_bytes(picture("PNG"))
    (tmp_path / "map.cfg").write_bytes(GOOD)
    return tmp_path


def findings(folder: Path, cfg: bytes | None = None, **limits: float) -> list[Finding]:
    if cfg is not None:
        (folder / "map.cfg").write_bytes(cfg)
    settings = Settings(photo=PhotoLimits(**limits))
    report = check_map.check_map(folder / "map.cfg", settings=settings, progress=Progress())
    assert report.errors + report.warnings == len(report.findings)
    return list(report.findings)


def summary(found: list[Finding]) -> list[tuple[str, int, int]]:
    return [(str(finding.code), finding.line, finding.column) for finding in found]


@pytest.mark.parametrize("cfg", [GOOD, b"\xef\xbb\xbf" + GOOD.replace(b"\n", b"\r\n") + b"\r\n", GOOD[:-1]])
def test_nothing_is_wrong(folder: Path, cfg: bytes) -> None:
    assert findings(folder, cfg) == []


def test_all_faults_are_reported_in_one_go(folder: Path) -> None:
    found = findings(
        folder,
        b"s.png;41;30\n"  # another size
        b"0;p/a.jpg;20,5;20\n"  # decimal comma
        b"zero;p/b.png;5;6\n"  # no number
        b"0;p/none.jpg;1;1\n"  # id twice, no photo
        b"3;../x.jpg;99;1\n"  # leaves the folder, outside the image
        b"4;p/c.jpg\n"  # columns
        b"\n"
        b"5;p/\xe9.jpg;1;1\n",  # not UTF-8
    )
    assert summary(found) == [
        ("image-size-differs", 1, 7),
        ("decimal-comma", 2, 11),
        ("non-numeric-id", 3, 1),
        ("duplicate-id", 4, 1),
        ("missing-photo", 4, 3),
        ("path-leaves-folder", 5, 3),
        ("position-outside-image", 5, 12),
        ("wrong-column-count", 6, 10),
        ("blank-line", 7, 1),
        ("not-utf-8", 8, 5),
    ]
    assert found[0].fix.startswith("write s.png;40;30")
    assert found[1].fix == "write 0;p/a.jpg;21;20"
    assert found[2].fix == "write 6;p/b.png;5;6"


def test_every_fix_that_is_a_line_is_accepted(folder: Path) -> None:
    broken = b"s.png;40;30\n0;p/a.jpg;20,4;20\nx;p/b.png;5.5;6\n"
    lines = broken.decode().splitlines()
    for _ in range(3):
        for finding in findings(folder, "\n".join(lines).encode()):
            if finding.fix.startswith("write "):
                lines[finding.line - 1] = finding.fix.removeprefix("write ")
    assert findings(folder) == []
    assert lines[1:] == ["0;p/a.jpg;20;20", "1;p/b.png;6;6"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("p/a.jpg", picture(size=(640, 480))[:-2000], "its end is missing"),
        ("p/a.jpg", b"", "empty"),
        ("p/a.jpg", b"<html>", "not an image"),
        ("p/b.png", picture("PNG")[:300], ""),
        ("p/a.jpg", picture(size=(2000, 1100)), "2 megapixels, more than"),
    ],
)
def test_unreadable_photo(folder: Path, name: str, content: bytes, words: str) -> None:
    (folder / name).write_bytes(content)
    (found,) = findings(folder, max_megapixels=2.0)
    assert found.code == Code.UNREADABLE_PHOTO and name in found.message and words in found.message


def test_too_large_a_file(folder: Path) -> None:
    found = findings(folder, max_mb=1e-4)
    assert {finding.code for finding in found} == {Code.UNREADABLE_PHOTO}


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (lambda path: path.unlink(), "missing-satellite"),
        (lambda path: path.write_bytes(b"no"), "unreadable-satellite"),
        (lambda path: path.write_bytes(picture("PNG", (40, 31))), "image-size-differs"),
    ],
)
def test_satellite(folder: Path, damage: Callable[[Path], None], code: str) -> None:
    damage(folder / "s.png")
    (found,) = findings(folder)
    assert (found.code, found.line) == (code, 1)


def test_misspelled_photos_get_a_suggestion(folder: Path) -> None:
    (folder / "p" / "Gate.JPG").write_bytes(picture())
    (folder / "p" / "pond.jpeg").write_bytes(picture())
    (folder / "lost.jpg").write_bytes(picture())
    found = findings(folder, GOOD + b"2;p/gate.jpg;1;1\n3;p/pond.jpg;1;1\n4;p/lost.jpg;1;1\n")
    missing = [finding.fix for finding in found if finding.code == Code.MISSING_PHOTO]
    assert ["p/Gate.JPG" in missing[0], "p/pond.jpeg" in missing[1], "'lost.jpg'" in missing[2]] == [True] * 3


def test_orphans(folder: Path) -> None:
    for name in (
        *("p/c.JPG", "d.heic", "derived/x.jpg", ".hidden/x.jpg", "notes.txt", "p/cut.jpg", "o.jpg"),
        "queries/asked.jpg",
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(picture())
    (folder / "other.cfg").write_bytes(b"s.png;40;30\n0;o.jpg;1;1\n")
    found = findings(folder, GOOD + b"7;p/cut.jpg;1\n")
    orphans = [finding for finding in found if finding.code == Code.ORPHAN_PHOTO]
    assert [finding.message.split("'")[1] for finding in orphans] == ["d.heic", "p/c.JPG"]
    assert "2;d.heic;X;Y" in orphans[0].fix and orphans[0].severity == "warning"


def test_photos_in_the_tray_are_no_orphans(folder: Path) -> None:
    for name in ("p/waits.jpg", "p/forgotten.jpg"):
        (folder / name).write_bytes(picture())
    tray = {
        "format": "experience-map",
        "version": 1,
        "next_id": 3,
        "unplaced": [{"id": 2, "photo": "p/waits.jpg"}],
    }
    (folder / "map.json").write_text(json.dumps(tray), "utf-8")
    (found,) = findings(folder)
    assert found.code == Code.ORPHAN_PHOTO and "p/forgotten.jpg" in found.message


def test_swapped_positions(folder: Path) -> None:
    found = findings(folder, b"s.png;40;30\n0;p/a.jpg;10;35\n1;p/b.png;20;38\n")
    assert [finding.code for finding in found].count(Code.SWAPPED_XY) == 1
    assert "swap the last two columns on every line" in [finding.fix for finding in found]


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_links_out_of_the_folder(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside") / "x.jpg"
    outside.write_bytes(picture())
    (folder / "p" / "a.jpg").unlink()
    (folder / "p" / "a.jpg").symlink_to(outside)
    (folder / "p" / "loop.jpg").symlink_to(folder / "p" / "loop.jpg")
    found = findings(folder, GOOD + b"2;p/loop.jpg;1;1\n")
    assert summary(found)[0] == ("path-leaves-folder", 2, 3)
    assert found[1].line == 4 and found[1].severity == "error"


@pytest.fixture
def full(folder: Path) -> Path:
    """The same with all side files."""
    photos = (Experience(0, "p/a.jpg", MapPixel(20.25, 10.25)), Experience(1, "p/b.png", MapPixel(5.5, 6.0)))
    placements = (Placement("clusters", {0: MapPixel(1.0, 1.0), 1: MapPixel(1.0, 1.0)}),)
    write_map(folder / "map.cfg", Map(SatelliteImage("s.png", 40, 30), photos, None, placements, 2, 1))
    return folder


def test_full_map_without_faults(full: Path) -> None:
    assert findings(full) == []


def test_cfg_edited_from_outside(full: Path) -> None:
    found = findings(full, b"s.png;40;30\n0;p/a.jpg;10;20\n1;p/b.png;7;6\n5;p/b.png;7;6\n")
    assert [(f.file, str(f.code), f.line) for f in found] == [
        ("", "swapped-xy", 2),
        ("", "map-json-position", 3),
        ("", "duplicate-photo", 4),
        ("map.json", "next-id-too-small", 1),
    ]
    assert found[0].fix == "write 0;p/a.jpg;20;10"
    assert all(finding.severity == "warning" for finding in found)
    assert read_map(full / "map.cfg").next_id == 6


def test_ids_that_no_longer_fit(full: Path) -> None:
    found = findings(full, b"s.png;40;30\n0;p/b.png;20;10\n")
    assert [(f.file, str(f.code), f.line) for f in found if f.code != Code.ORPHAN_PHOTO] == [
        ("", "map-json-stale", 2),
        ("clusters.cfg", "placement-damaged", 2),
        ("clusters.cfg", "placement-stale", 3),
        ("map.json", "map-json-stale", 1),
    ]


def test_swapped_against_gps(folder: Path) -> None:
    georeference = Georeference("EPSG:4326", (1e-5, 0.0, 22.0, 0.0, -1e-5, 60.0, 0.0, 0.0, 1.0), "corners")
    photos = []
    for i, (x, y) in enumerate([(2.0, 28.0), (5.0, 25.0), (1.0, 29.0)]):
        at = georeference.latlon_of(MapPixel(x, y))
        lat, lon = (((round(value * 3_600_000), 3_600_000),) for value in at)
        exif = {"GPS": {1: b"N", 2: (*lat, (0, 1), (0, 1)), 3: b"E", 4: (*lon, (0, 1), (0, 1))}}
        Image.new("RGB", (64, 48)).save(folder / f"{i}.jpg", exif=piexif.dump(exif))
        photos.append(Experience(i, f"{i}.jpg", MapPixel(y, x)))
    write_map(folder / "map.cfg", Map(SatelliteImage("s.png", 40, 30), tuple(photos), georeference, (), 3))
    found = [finding for finding in findings(folder) if finding.code != Code.ORPHAN_PHOTO]
    assert [(str(finding.code), finding.line) for finding in found] == [("swapped-xy", 2)]
    assert "0;0.jpg;2;28" in found[0].fix


def test_damaged_json(full: Path) -> None:
    content = json.loads((full / "map.json").read_bytes())
    content["experiences"][0]["fov_deg"] = -1
    (full / "map.json").write_text(json.dumps(content))
    (found,) = findings(full)
    assert (found.file, found.code) == ("map.json", Code.MAP_JSON_DAMAGED)
    assert "$.experiences[0].fov_deg" in found.message and found.fix


def test_damaged_placements(full: Path) -> None:
    (full / "clusters.cfg").write_bytes(b"s.png;40;31\n0;p/a.jpg;1,5;1\n0;p/b.png;50;1\n")
    assert [(f.file, *summary([f])[0]) for f in findings(full)] == [
        ("clusters.cfg", "placement-damaged", 1, 1),
        ("clusters.cfg", "decimal-comma", 2, 11),
        ("clusters.cfg", "duplicate-id", 3, 1),
        ("clusters.cfg", "placement-damaged", 3, 3),
        ("clusters.cfg", "position-outside-image", 3, 11),
    ]
    (full / "clusters.cfg").unlink()
    (missing,) = findings(full)
    assert missing.code == Code.PLACEMENT_DAMAGED and "put clusters.cfg back" in missing.fix


def test_binary_file_is_reported_and_not_a_crash(folder: Path) -> None:
    found = findings(folder, picture("PNG", (300, 200)))
    assert found and all(finding.fix for finding in found)


def test_missing_map_and_cancelling(folder: Path) -> None:
    with pytest.raises(MapError, match="map file not found"):
        check_map.check_map(folder / "none.cfg", settings=Settings(), progress=Progress())

    class Stopped(Progress):
        def cancelled(self) -> bool:
            return True

    with pytest.raises(Cancelled):
        check_map.check_map(folder / "map.cfg", settings=Settings(), progress=Stopped())


@pytest.mark.parametrize("name", ["gardens_point"])
def test_real_map_has_no_errors(shared_data: Path, name: str) -> None:
    report = check_map.check_map(shared_data / name / "map.cfg", settings=Settings(), progress=Progress())
    assert report.errors == 0 and report.photos == 200
    assert {finding.code for finding in report.findings} == {Code.ORPHAN_PHOTO}


def test_real_odd_photos_are_judged(shared_data: Path, tmp_path: Path) -> None:
    photos = sorted((shared_data / "odd_photos").iterdir())
    lines = [f"{i};{path.name};1;1" for i, path in enumerate(photos)]
    (tmp_path / "map.cfg").write_text("\n".join(["s.png;40;30", *lines]), "utf-8")
    (tmp_path / "s.png").write_bytes(picture("PNG", (40, 30)))
    for path in photos:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    found = findings(tmp_path)
    assert {finding.code for finding in found} <= {Code.UNREADABLE_PHOTO}
    assert not any("heic" in finding.message for finding in found)


def test_the_kind_of_map_and_its_place_radius_by_the_positions(folder: Path) -> None:
    settings = Settings()

    def places(cfg: bytes) -> MapPlaces | None:
        (folder / "map.cfg").write_bytes(cfg)
        return check_map.check_map(folder / "map.cfg", settings=settings, progress=Progress()).places

    metric = places(GOOD)
    assert metric is not None and metric.kind == "metric"
    assert metric.radius_px == pytest.approx(2 * math.hypot(15, 14))
    floors = b"s.png;400;300\n" + b"".join(b"%d;p/a.jpg;%d;20\n" % (n, 100 * (n % 3)) for n in range(60))
    areas = places(floors)
    assert areas is not None and areas.kind == "areas" and areas.radius_px == pytest.approx(40.0)
    assert places(b"s.png;40;30\n") is None
