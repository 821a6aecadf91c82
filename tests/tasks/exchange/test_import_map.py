"""A zip becomes a map; a hostile one is rejected without traces."""

import io
import json
import shutil
import stat
import zipfile
from collections import Counter
from copy import copy
from dataclasses import replace

import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Placement
from webapp.errors import Conflict, DiskFull, ExpMapError, InputError, MapError, NotFound
from webapp.files.maps.folder import read_map, write_map
from webapp.settings import ImportLimits, Settings
from webapp.store.maps import maps
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import export_files, import_map
from webapp.tasks.maps import adopt_map, check_map, export


@pytest.fixture
def park(make_map, tmp_path):
    """The files of a small map, by name."""
    cfg = make_map(tmp_path / "original", 2)
    return {
        p.relative_to(cfg.parent).as_posix(): p.read_bytes() for p in cfg.parent.rglob("*") if p.is_file()
    }


@pytest.fixture
def bring(library, owner, tmp_path):
    """Zip files and import them."""

    def run(files, *, name="Park", limits=None, method=zipfile.ZIP_STORED):
        path = tmp_path / "map.zip"
        with zipfile.ZipFile(path, "w", method) as archive:
            for key, content in files.items():
                archive.writestr(key, content)
        settings = Settings(imports=limits or ImportLimits())
        return import_map.import_map(library, path, account_id=owner, name=name, settings=settings)

    return run


@pytest.fixture
def nothing_is_left(library):
    """Check that the library has no map, no folder and no partial data."""
    yield
    assert [p.name for p in library.folder.iterdir()] == [".library"]
    assert list((library.inner / "imports").iterdir()) == []
    with library.database.read() as session:
        assert session.query(MapRecord).count() == 0


def in_folder(files, folder):
    return {f"{folder}/{name}": content for name, content in files.items()}


def test_what_was_exported_comes_back_as_it_was(adopt, library, bring, edit, tmp_path):
    map_id = adopt()
    edit(map_id, {"photo/1": {"x_px": 50.25, "y_px": 60.5, "heading_deg": 12.5}})
    edit(map_id, {"placed/clusters/1": {"x_px": 7.5, "y_px": 8.0}})
    with zipfile.ZipFile(
        io.BytesIO(b"".join(export_files.export_map_zip(library, map_id).pieces))
    ) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    done = bring(files, name="Park again")
    assert (done.slug, done.findings, done.left_out) == ("park-again", (), ())
    assert export.export_map(library, done.map_id)
    for name in ("map.cfg", "map.json", "clusters.cfg", "plan.png", "photos/0.jpg"):
        assert (library.map_folder(done.slug) / name).read_bytes() == files[name]
    assert read_map(library.cfg(done.slug)) == read_map(library.cfg("park"))


@pytest.mark.parametrize("folder", ["Park", "a/b c/d"])
def test_a_nested_folder(park, bring, library, folder):
    around = {"readme.txt": b"hello", f"__MACOSX/{folder}/._map.cfg": b"\0", f"{folder}/.DS_Store": b"\0"}
    done = bring({**in_folder(park, folder), **around, f"{folder}/derived/map.cfg": b"x"})
    assert len(read_map(library.cfg(done.slug)).experiences) == 2
    assert "readme.txt" in done.left_out and len(done.left_out) == 4


def test_a_cfg_of_another_name_becomes_the_map(park, bring, library):
    park["park.cfg"] = park.pop("map.cfg")
    done = bring(park)
    assert len(read_map(library.cfg(done.slug)).experiences) == 2


def test_programs_are_left_out(park, bring, library):
    done = bring({**park, "photos/run.exe": b"MZ", "index.html": b"<script>"})
    assert done.left_out == ("photos/run.exe", "index.html")
    assert not (library.map_folder(done.slug) / "index.html").exists()


def test_backslashes_of_old_programs_are_folders(park, bring, library):
    done = bring({name.replace("/", "\\"): content for name, content in park.items()})
    assert done.findings == ()


def test_another_cfg_with_the_same_photos_is_a_placement(park, bring, library):
    done = bring({**park, "clusters.cfg": b"plan.png;300;200\n1;photos/1.jpg;5;6\n"})
    assert read_map(library.cfg(done.slug)).placements == (Placement("clusters", {1: MapPixel(5, 6)}),)
    assert (library.map_folder(done.slug) / "map.cfg").read_bytes() == park["map.cfg"]


def test_placements_that_map_json_names_do_not_make_a_second_map(park, bring, library, tmp_path):
    cfg = tmp_path / "original" / "map.cfg"
    map_ = read_map(cfg)
    write_map(cfg, replace(map_, placements=(Placement("rough", {0: MapPixel(1.5, 2)}),)))
    files = {p.name: p.read_bytes() for p in cfg.parent.glob("*.*")}
    done = bring({**park, **files})
    assert read_map(library.cfg(done.slug)).placements[0].positions == {0: MapPixel(1.5, 2)}


@pytest.mark.usefixtures("nothing_is_left")
@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"b.cfg": b"other.png;3;3\n"}, "not placements of map.cfg.*'b.cfg'"),
        ({"b.cfg": b"plan.png;300;200\n0;photos/1.jpg;5;6\n"}, "not placements of map.cfg.*'b.cfg'"),
        ({"other/map.cfg": b"plan.png;300;200\n"}, "several maps: 'map.cfg', 'other/map.cfg'"),
        ({"other/b.cfg": b"plan.png;300;200\n"}, "other folders: 'other/b.cfg'"),
    ],
)
def test_a_question_is_asked_by_name(park, bring, more, message):
    with pytest.raises(InputError, match=message):
        bring({**park, **more})


@pytest.mark.usefixtures("nothing_is_left")
def test_several_maps_without_a_main_one(park, bring):
    park["a.cfg"] = park.pop("map.cfg")
    with pytest.raises(InputError, match=r"several maps: 'a.cfg', 'b.cfg'"):
        bring({**park, "b.cfg": park["a.cfg"]})


@pytest.mark.usefixtures("nothing_is_left")
@pytest.mark.parametrize(
    "name",
    [
        "../evil.jpg",
        "photos/../../evil.jpg",
        "/etc/evil.jpg",
        "C:/evil.jpg",
        "..\\evil.jpg",
        "a\n.jpg",
        "a;b.jpg",
    ],
)
def test_no_path_leads_out(park, bring, tmp_path, name):
    with pytest.raises(InputError):
        bring({**park, name: b"evil"})
    assert not list(tmp_path.rglob("evil*"))


@pytest.mark.usefixtures("nothing_is_left")
def test_links_are_refused(park, bring):
    link = zipfile.ZipInfo("photos/link.jpg")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with pytest.raises(InputError, match="is a link"):
        bring({**park, link: b"/etc/passwd"})


@pytest.mark.usefixtures("nothing_is_left")
@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (ImportLimits(max_files=3), "more than the limit of 3"),
        (ImportLimits(max_mb=0.001, max_ratio=1e9), "more than the limit of 0.001"),
        (ImportLimits(max_ratio=50), "times as large"),
    ],
)
def test_bombs(park, bring, limits, message):
    with pytest.raises(InputError, match=message):
        bring({**park, "bomb.bmp": bytes(3_000_000)}, limits=limits, method=zipfile.ZIP_DEFLATED)


@pytest.mark.usefixtures("nothing_is_left")
@pytest.mark.parametrize(
    "names", [("photos/A.jpg", "photos/a.JPG"), ("p/e\u0301.jpg", "p/\u00e9.jpg"), ("x.jpg", "x.jpg/y.jpg")]
)
def test_names_that_are_one_file_on_some_disks(park, bring, names):
    with pytest.raises(InputError):
        bring({**park, **dict.fromkeys(names, b"x")})


@pytest.mark.usefixtures("nothing_is_left")
def test_names_too_long_for_the_disk(park, bring):
    with pytest.raises(InputError, match="too long"):
        bring({**park, f"{'x' * 250}.jpg": b"x"})


@pytest.mark.usefixtures("nothing_is_left")
def test_a_zip_that_lies_about_sizes(park, bring, library, owner, tmp_path):
    bring_nothing = tmp_path / "lies.zip"
    with zipfile.ZipFile(bring_nothing, "w") as archive:
        for name, content in park.items():
            archive.writestr(name, content)
    data = bytearray(bring_nothing.read_bytes())
    directory = data.index(b"PK\x01\x02", data.rindex(b"PK\x03\x04"))
    data[directory + 24 : directory + 28] = (5).to_bytes(4, "little")
    bring_nothing.write_bytes(data)
    with pytest.raises(InputError):
        import_map.import_map(library, bring_nothing, account_id=owner, name="x", settings=Settings())


@pytest.mark.usefixtures("nothing_is_left")
@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04" + bytes(100)])
def test_what_is_no_zip(library, owner, tmp_path, content):
    (library.inner / "imports").mkdir()
    (tmp_path / "x.zip").write_bytes(content)
    with pytest.raises(InputError, match="not a zip"):
        import_map.import_map(library, tmp_path / "x.zip", account_id=owner, name="x", settings=Settings())


@pytest.mark.usefixtures("nothing_is_left")
def test_a_cut_off_photo_of_the_zip_itself(park, library, owner, tmp_path):
    path = tmp_path / "cut.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in park.items():
            archive.writestr(name, content)
    data = bytearray(path.read_bytes())
    data[2000:2100] = bytes(100)
    path.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        import_map.import_map(library, path, account_id=owner, name="x", settings=Settings())


@pytest.mark.parametrize("method", ["STORED", "DEFLATED", "BZIP2", "LZMA"])
def test_damage_anywhere_in_a_zip_is_no_error_of_the_disk(park, library, owner, tmp_path, method):
    path = tmp_path / "damaged.zip"
    with zipfile.ZipFile(path, "w", getattr(zipfile, f"ZIP_{method}")) as archive:
        for name, content in park.items():
            archive.writestr(name, content)
    whole = path.read_bytes()
    directory = whole.index(b"PK\x01\x02")
    refused = 0
    for place in (40, 400, directory // 2, directory + 42, directory + 46, len(whole) - 10, len(whole) - 6):
        path.write_bytes(whole[:place] + b"\xf0\xff\xff\xf0" + whole[place + 4 :])
        try:
            import_map.import_map(library, path, account_id=owner, name=f"{place}", settings=Settings())
        except (InputError, MapError):
            refused += 1
    assert refused >= 4


@pytest.mark.usefixtures("nothing_is_left")
def test_a_zip_leaves_the_disk_space_that_uploads_leave(park, bring, library, monkeypatch):
    (library.inner / "imports").mkdir()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 0, 200_000_000))
    with pytest.raises(DiskFull, match=r"MB are needed, .* of which 200 MB are kept free"):
        bring(park)


@pytest.mark.usefixtures("nothing_is_left")
def test_a_file_without_a_name_is_refused(park, library, owner, tmp_path):
    path = tmp_path / "nameless.zip"
    (library.inner / "imports").mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {**park, "Qx.jpg": b"x"}.items():
            archive.writestr(name, content)
    path.write_bytes(path.read_bytes().replace(b"Qx.jpg", b"\0x.jpg"))
    with pytest.raises(InputError, match="the name is empty"):
        import_map.import_map(library, path, account_id=owner, name="x", settings=Settings())


@pytest.mark.usefixtures("nothing_is_left")
def test_lines_are_counted_before_anything_is_looked_for(park, bring, monkeypatch):
    monkeypatch.setattr(import_map, "choose_map", None)
    many = "".join(f"{n};photos/{n}.jpg;1;1\n" for n in range(101))
    with pytest.raises(InputError, match="the map has 102 lines, more than the limit of 100"):
        bring({**park, "map.cfg": f"satellite.png;400;300\n{many}"}, limits=ImportLimits(max_files=100))


@pytest.fixture
def counted(monkeypatch):
    """How often photos are decoded and read in an import, by the function."""
    calls = Counter()

    def count(module, name):
        function = getattr(module, name)

        def counting(*args, **options):
            calls[name] += 1
            return function(*args, **options)

        monkeypatch.setattr(module, name, counting)

    for module in (check_map, adopt_map):
        count(module, "check_decodes")
    count(adopt_map, "read_file")
    return calls


def test_a_photo_is_read_once_however_many_lines_name_it_in_whatever_way(park, bring, rows, counted):
    names = ["photos/0.jpg", "./photos/0.jpg", "photos//0.jpg", "photos/1.jpg"]
    lines = "".join(f"{n};{names[n % 4]};{n};1\n" for n in range(200))
    done = bring({**park, "map.cfg": f"plan.png;300;200\n{lines}"})
    assert counted == {"check_decodes": 2, "read_file": 2}
    there = rows(done.map_id)
    assert [there[n].path for n in range(4)] == names and there[7].x_px == 7.0
    assert len(there) == 200 and {row.width for row in there.values()} == {there[0].width}
    assert len({row.sha256 for row in there.values()}) == 200, "unique, as uploads are recognised by it"


def test_a_photo_that_cannot_be_read_is_reported_for_each_line(park, bring, counted):
    lines = "".join(f"{n};photos/0.jpg;{n};1\n" for n in range(9))
    done = bring({**park, "photos/0.jpg": b"no photo", "map.cfg": f"plan.png;300;200\n{lines}"})
    assert [f.code for f in done.findings].count("unreadable-photo") == 9
    assert counted["check_decodes"] == 2


@pytest.mark.usefixtures("nothing_is_left")
def test_files_that_share_bytes_of_the_zip_are_refused(park, library, owner, tmp_path):
    path = tmp_path / "overlap.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in park.items():
            archive.writestr(name, content)
        first = copy(archive.getinfo("photos/0.jpg"))
        first.filename = "photos/again.jpg"
        archive.filelist.append(first)
    with pytest.raises(InputError, match="files in the zip overlap"):
        import_map.import_map(library, path, account_id=owner, name="x", settings=Settings())


@pytest.mark.usefixtures("nothing_is_left")
def test_many_small_files_are_no_bomb_either(park, bring):
    many = {f"photos/p{n}.bmp": bytes(900_000) for n in range(20)}
    with pytest.raises(InputError, match=r"the zip would become .* times as large"):
        bring({**park, **many}, method=zipfile.ZIP_DEFLATED)


@pytest.mark.usefixtures("nothing_is_left")
@pytest.mark.parametrize(
    ("part", "limits", "message"),
    [
        ({"notes": [{"id": n, "title": "x"} for n in range(1001)]}, None, "1001 notes, more than 1000"),
        ({"unplaced": [{}] * 2000}, ImportLimits(max_files=50), "more than 2000 values"),
    ],
)
def test_map_json_has_no_more_than_a_map_of_the_library(park, bring, part, limits, message):
    about = {"format": "experience-map", "version": 1, **part}
    with pytest.raises(ExpMapError, match=message):
        bring({**park, "map.json": json.dumps(about)}, limits=limits)


@pytest.mark.usefixtures("nothing_is_left")
def test_ids_leave_room_for_further_photos(park, bring):
    cfg = park["map.cfg"]
    text = cfg.decode() if isinstance(cfg, bytes) else cfg
    first, _, rest = text.partition("\n")
    with pytest.raises(MapError, match="2147483647 is so large"):
        bring({**park, "map.cfg": f"{first}\n{2**31 - 1}{rest[rest.index(';') :]}"})


@pytest.mark.usefixtures("nothing_is_left")
def test_all_errors_of_a_map_are_reported_at_once(park, bring):
    park["map.cfg"] = b"plan.png;300;200\n0;photos/0.jpg;1,5;2\n0;photos/1.jpg;2;3\n1;photos/1.jpg;999;3\n"
    with pytest.raises(import_map.MapRefused) as caught:
        bring(park)
    assert {f.code for f in caught.value.findings} >= {"not-an-integer", "position-outside-image"} or {
        f.code for f in caught.value.findings
    } >= {"decimal-comma", "position-outside-image"}
    assert "map.cfg:2" in caught.value.message and "more error" in caught.value.message


@pytest.mark.usefixtures("nothing_is_left")
def test_without_its_image_a_map_is_refused(park, bring):
    del park["plan.png"]
    with pytest.raises(import_map.MapRefused, match="no satellite image"):
        bring(park)


def test_missing_photos_are_reported_and_the_others_are_there(park, bring, rows):
    del park["photos/0.jpg"]
    done = bring(park)
    assert [f.code for f in done.findings] == ["missing-photo"]
    assert [row.width > 0 for row in rows(done.map_id).values()] == [False, True]


def test_the_folder_of_an_import_that_just_ended_is_no_error(park, bring, library):
    """It is removed between listing the folders and looking at it."""
    (library.inner / "imports").mkdir(exist_ok=True)
    (library.inner / "imports" / "gone").symlink_to("nowhere")
    assert bring(park).slug == "park"


def test_two_imports_of_one_name(park, bring):
    assert [bring(park).slug, bring(park).slug] == ["park", "park-2"]


@pytest.fixture
def empty(library, owner):
    """The id of an empty map."""
    with library.database.write() as session:
        return maps.create(session, "Later", account_id=owner).id


@pytest.fixture
def archive(park, tmp_path):
    path = tmp_path / "park.zip"
    with zipfile.ZipFile(path, "w") as opened:
        for name, content in park.items():
            opened.writestr(name, content)
    return path


def test_an_empty_map_is_filled_once(library, empty, archive, rows):
    export.export_map(library, empty)
    done = [import_map.run_into(library, archive, map_id=empty, settings=Settings()) for _ in range(2)]
    assert done[0] == done[1] and done[0].slug == "later"
    assert len(rows(empty)) == 2 and len(read_map(library.cfg("later")).experiences) == 2
    with library.database.read() as session:
        assert jobs.newest(session, empty, kind=INDEX_JOB, key="").state == "queued"


def test_an_import_that_was_killed_between_files_and_records_is_done_again(library, empty, archive, rows):
    left = library.map_folder("later") / "photos" / "old.jpg"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"half")
    import_map.run_into(library, archive, map_id=empty, settings=Settings())
    assert not left.exists() and len(rows(empty)) == 2


def test_a_map_with_something_in_it_is_not_overwritten(adopt, library, archive):
    map_id = adopt()
    before = library.cfg("park").read_bytes()
    with pytest.raises(Conflict, match="no longer empty"):
        import_map.run_into(library, archive, map_id=map_id, settings=Settings())
    assert library.cfg("park").read_bytes() == before


def test_a_map_that_is_gone(library, archive):
    with pytest.raises(NotFound):
        import_map.run_into(library, archive, map_id=99, settings=Settings())


def test_a_list_of_very_many_files_is_not_read(bring, park, monkeypatch, nothing_is_left):
    monkeypatch.setattr(zipfile.ZipFile, "infolist", lambda self: pytest.fail("it was read"))
    many = {f"notes/{number:060}.txt": b"" for number in range(2000)}
    with pytest.raises(InputError, match="more files than the limit of 10"):
        bring({**park, **many}, limits=ImportLimits(max_files=10))
