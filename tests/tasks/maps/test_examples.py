"""Photos that come with a map to try it on."""

import pytest
from PIL import Image

from webapp.errors import NotFound
from webapp.settings import Settings
from webapp.tasks.maps.examples import Example, examples_of, file_of, path_of
from webapp.tasks.maps.pictures import give_picture


def test_only_photos_of_the_folder_are_examples(tmp_path):
    cfg = tmp_path / "map.cfg"
    assert examples_of(cfg) == []
    folder = tmp_path / "queries"
    folder.mkdir()
    for name in ("b.jpg", "a.PNG", "notes.txt"):
        (folder / name).touch()
    (tmp_path / "secret.jpg").touch()
    (folder / "link.jpg").symlink_to(tmp_path / "secret.jpg")
    assert examples_of(cfg) == [Example("a.PNG", False), Example("b.jpg", False)]
    assert path_of(cfg, "b.jpg") == folder / "b.jpg"
    for name in ("link.jpg", "../secret.jpg", "notes.txt"):
        with pytest.raises(NotFound):
            path_of(cfg, name)


def test_a_folder_that_is_a_link_is_left_alone(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.jpg").touch()
    (tmp_path / "queries").symlink_to(tmp_path / "elsewhere")
    assert examples_of(tmp_path / "map.cfg") == []


def test_photos_without_a_position_in_the_list_come_last(tmp_path):
    (tmp_path / "queries").mkdir()
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        (tmp_path / "queries" / name).touch()
    (tmp_path / "queries.csv").write_text("path;x;y\nqueries/b.jpg;1;2\nqueries/c.jpg;3;4\n")
    assert [(example.name, example.elsewhere) for example in examples_of(tmp_path / "map.cfg")] == [
        ("b.jpg", False),
        ("c.jpg", False),
        ("a.jpg", True),
    ]


def test_a_small_picture_is_made_once(tmp_path, save_photo, new_library):
    library = new_library(tmp_path / "library")
    save_photo(tmp_path / "queries" / "a.jpg", 1)
    photo = file_of(tmp_path / "map.cfg", "a.jpg")

    def thumb():
        options = {"kind": "thumb", "audience": "members", "settings": Settings()}
        return give_picture(library, photo, **options).path

    with Image.open(thumb()) as image:
        assert max(image.size) <= 256
    made = thumb().stat().st_mtime_ns
    assert thumb().stat().st_mtime_ns == made
