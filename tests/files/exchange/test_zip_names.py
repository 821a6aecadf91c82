"""Names in zips that do not state their encoding."""

import time
import unicodedata
import zipfile

import pytest

from webapp.errors import InputError
from webapp.files.exchange.map_zip import is_quick, names_of, unpack
from webapp.progress import Progress
from webapp.settings import ImportLimits

NAMES = ("photos/Straße 1.jpg", "photos/café.jpg", "photos/plain.jpg")


def write_zip(path, files):
    """Write a zip with names as bytes, without the flag of UTF-8."""
    with zipfile.ZipFile(path, "w") as archive:
        for number, (raw, content) in enumerate(files.items()):
            archive.writestr(f"{number}".rjust(len(raw), "x"), content)
    data = path.read_bytes()
    for number, raw in enumerate(files):
        data = data.replace(f"{number}".rjust(len(raw), "x").encode(), raw)
    path.write_bytes(data)


@pytest.fixture
def unpacked(tmp_path):
    """Unpack a zip with raw names; return the names of its photos."""

    def run(files):
        write_zip(tmp_path / "map.zip", files)
        (tmp_path / "out").mkdir()
        unpack(
            tmp_path / "map.zip", tmp_path / "out", limits=ImportLimits(), reserve_mb=0, progress=Progress()
        )
        found = list((tmp_path / "out").rglob("*.jpg"))
        return sorted(p.relative_to(tmp_path / "out").as_posix() for p in found)

    return run


def cfg(*names):
    return "\n".join(["plan.png;9;9", *(f"{n};{name};1;1" for n, name in enumerate(names))]).encode()


@pytest.mark.parametrize("encoding", ["utf-8", "cp437", "cp1252", "cp850"])
@pytest.mark.parametrize("folder", ["", "Plán ä/"])
def test_names_are_those_that_the_map_names(unpacked, encoding, folder):
    files = {f"{folder}{name}".encode(encoding): b"photo" for name in NAMES}
    files[f"{folder}map.cfg".encode(encoding)] = cfg(*NAMES)
    assert unpacked(files) == sorted(f"{folder}{name}" for name in NAMES)


@pytest.mark.parametrize("encoding", ["cp1250", "cp852"])
def test_code_pages_of_central_europe(unpacked, encoding):
    names = ("Žižkov.jpg", "Łódź.jpg")
    files = {name.encode(encoding): b"photo" for name in names}
    assert unpacked({**files, b"map.cfg": cfg(*names)}) == sorted(names)


@pytest.mark.parametrize("folder", ["", "Mapa é/"])
@pytest.mark.parametrize(("stored", "named"), [("NFD", "NFC"), ("NFC", "NFD"), ("NFD", "NFD")])
def test_decomposed_names_of_the_finder_get_the_form_of_the_map(unpacked, folder, stored, named):
    files = {(folder + unicodedata.normalize(stored, name)).encode(): b"photo" for name in NAMES}
    names = [unicodedata.normalize(named, name) for name in NAMES]
    files[f"{folder}map.cfg".encode()] = cfg(*names)
    assert unpacked(files) == sorted(folder + name for name in names)


def test_decomposed_names_with_the_flag_get_the_form_of_the_map(tmp_path):
    (tmp_path / "out").mkdir()
    with zipfile.ZipFile(tmp_path / "map.zip", "w") as archive:
        archive.writestr("cafe\u0301.jpg", b"1")
        archive.writestr("CAF\u00c9 2.jpg", b"2")
        archive.writestr("map.cfg", cfg("caf\u00e9.jpg", "caf\u00e9 2.jpg"))
    unpack(tmp_path / "map.zip", tmp_path / "out", limits=ImportLimits(), reserve_mb=0, progress=Progress())
    # another case is another name
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"caf\u00e9.jpg", "CAF\u00c9 2.jpg", "map.cfg"}


def test_without_a_map_that_names_them_names_are_utf_8_where_valid_and_cp437_otherwise(unpacked):
    found = unpacked({"photos/é.jpg".encode(): b"1", "photos/ü.jpg".encode("cp437"): b"2", b"map.cfg": b"x"})
    assert found == ["photos/é.jpg", "photos/ü.jpg"]


def test_names_that_look_like_utf_8_are_what_the_map_names(unpacked):
    name = "photos/Ã©.jpg"
    assert unpacked({name.encode("cp1252"): b"1", b"map.cfg": cfg(name)}) == [name]


def test_a_name_outside_the_folder_is_refused_in_any_encoding(tmp_path):
    write_zip(tmp_path / "map.zip", {"../é.jpg".encode(): b"1"})
    with pytest.raises(Exception, match="cannot have"):
        unpack(tmp_path / "map.zip", tmp_path, limits=ImportLimits(), reserve_mb=0, progress=Progress())


def damaged(path, compression, *, count, size, folder="é"):
    """Write a zip with `.cfg` files whose checksums are wrong, each of which is unpacked to `size` bytes."""
    with zipfile.ZipFile(path, "w", compression) as archive:
        for number in range(count):
            archive.writestr(f"{folder}{number}.cfg", b"\0" * size)
        checksum = f"{archive.infolist()[0].CRC:08x}"
    data = path.read_bytes()
    path.write_bytes(data.replace(bytes.fromhex(checksum)[::-1], b"\1\2\3\4"))


@pytest.fixture
def unpacked_bytes(monkeypatch):
    """Count the bytes that are unpacked."""
    counted = []
    read = zipfile.ZipExtFile.read

    def counting(self, n=-1):
        try:
            return read(self, n)
        finally:
            counted.append(n)

    monkeypatch.setattr(zipfile.ZipExtFile, "read", counting)
    return counted


def test_nothing_is_unpacked_before_sizes_are_checked(tmp_path, unpacked_bytes):
    damaged(tmp_path / "map.zip", zipfile.ZIP_DEFLATED, count=20, size=10_000_000)
    assert not is_quick(tmp_path / "map.zip", limits=ImportLimits())
    with pytest.raises(InputError, match="times as large"):
        unpack(tmp_path / "map.zip", tmp_path, limits=ImportLimits(), reserve_mb=0, progress=Progress())
    assert unpacked_bytes == []


def test_damaged_files_count_for_the_bytes_that_are_read_for_names(tmp_path, unpacked_bytes):
    damaged(tmp_path / "map.zip", zipfile.ZIP_DEFLATED, count=100, size=50_000)
    with zipfile.ZipFile(tmp_path / "map.zip") as opened:
        infos = opened.infolist()
        assert names_of(opened, infos, cfgs=infos) == [f"é{number}.cfg" for number in range(100)]
    assert len(unpacked_bytes) == 60


def test_a_corrupt_cfg_does_not_keep_names_from_being_read(tmp_path):
    with zipfile.ZipFile(tmp_path / "map.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("map.cfg", cfg(*NAMES) * 20)
        archive.writestr("é.jpg", b"1")
        begin = archive.infolist()[0].header_offset + 30 + len("map.cfg")
    data = bytearray((tmp_path / "map.zip").read_bytes())
    data[begin : begin + 8] = b"\xff" * 8
    (tmp_path / "map.zip").write_bytes(data)
    with zipfile.ZipFile(tmp_path / "map.zip") as opened:
        infos = opened.infolist()
        assert names_of(opened, infos, cfgs=infos[:1]) == ["map.cfg", "é.jpg"]


def test_many_folders_with_a_cfg_take_little_time(tmp_path):
    with zipfile.ZipFile(tmp_path / "map.zip", "w") as archive:
        for number in range(15_000):
            archive.writestr(f"é{number}/map.cfg", b"")
    with zipfile.ZipFile(tmp_path / "map.zip") as opened:
        infos = opened.infolist()
        before = time.process_time()
        assert len(names_of(opened, infos, cfgs=infos)) == 15_000
        assert time.process_time() - before < 2
