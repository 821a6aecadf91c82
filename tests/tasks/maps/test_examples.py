"""Photos that come with a map to try it on."""

import pytest
from PIL import Image

from webapp.errors import NotFound
from webapp.settings import PhotoLimits
from webapp.tasks.maps.examples import names_of, path_of, thumb_of


def test_only_photos_of_the_folder_are_examples(tmp_path):
    cfg = tmp_path / "map.cfg"
    assert names_of(cfg) == []
    folder = tmp_path / "queries"
    folder.mkdir()
    for name in ("b.jpg", "a.PNG", "notes.txt"):
        (folder / name).touch()
    (tmp_path / "secret.jpg").touch()
    (folder / "link.jpg").symlink_to(tmp_path / "secret.jpg")
    assert names_of(cfg) == ["a.PNG", "b.jpg"]
    assert path_of(cfg, "b.jpg") == folder / "b.jpg"
    for name in ("link.jpg", "../secret.jpg", "notes.txt"):
        with pytest.raises(NotFound):
            path_of(cfg, name)


def test_a_folder_that_is_a_link_is_left_alone(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.jpg").touch()
    (tmp_path / "queries").symlink_to(tmp_path / "elsewhere")
    assert names_of(tmp_path / "map.cfg") == []


def test_a_small_picture_is_made_once(tmp_path, save_photo):
    cfg = tmp_path / "map.cfg"
    save_photo(tmp_path / "queries" / "a.jpg", 1)
    thumb = thumb_of(cfg, "a.jpg", limits=PhotoLimits())
    with Image.open(thumb) as image:
        assert max(image.size) <= 256
    made = thumb.stat().st_mtime_ns
    assert thumb_of(cfg, "a.jpg", limits=PhotoLimits()).stat().st_mtime_ns == made
