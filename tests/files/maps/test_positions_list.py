"""Positions of photos by file name."""

import pytest

from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import CfgError, TableError
from webapp.files.maps.positions import read_positions


def listing(tmp_path, text, name="list.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_degrees(tmp_path):
    found = read_positions(listing(tmp_path, "name;lat;lon\na/1.jpg;50.5;14\nb\\2.jpg;-1;2\n"))
    assert found.by_name == {"a/1.jpg": LatLon(50.5, 14), "b/2.jpg": LatLon(-1, 2)}
    assert not found.in_pixels
    assert found.image_size is None


def test_pixels(tmp_path):
    found = read_positions(listing(tmp_path, "Name; X; Y\n1.jpg;10.5;20\n"))
    assert found.by_name == {"1.jpg": MapPixel(10.5, 20)}
    assert found.in_pixels


def test_a_map_file(tmp_path):
    found = read_positions(listing(tmp_path, "plan.png;100;80\n7;photos/1.jpg;10;20\n", "other.cfg"))
    assert found.by_name == {"photos/1.jpg": MapPixel(10, 20)}
    assert (found.in_pixels, found.image_size) == (True, (100, 80))


def test_names_are_found_by_path_or_by_an_only_file_name(tmp_path):
    found = read_positions(listing(tmp_path, "name;x;y\na/1.jpg;1;1\nb/1.jpg;2;2\nb/2.jpg;3;3\n4.jpg;4;4\n"))
    assert found.find("a/1.jpg") == (1, 1)
    assert found.find("c/2.jpg") == (3, 3)
    assert found.find("deep/down/4.jpg") == (4, 4)
    assert found.find("1.jpg") is None
    assert found.find("5.jpg") is None


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("name;lon;lat\n", "header"),
        ("name;x;y\n1.jpg;a;2\n", ":2"),
        ("name;x;y\n1.jpg;1;2\n1.jpg;3;4\n", ":3"),
        ("name;lat;lon\n1.jpg;140;50\n", "swapped"),
    ],
)
def test_bad_tables_are_refused(tmp_path, text, part):
    with pytest.raises(TableError) as caught:
        read_positions(listing(tmp_path, text))
    assert part in str(caught.value)


def test_a_bad_map_file_is_refused(tmp_path):
    with pytest.raises(CfgError):
        read_positions(listing(tmp_path, "plan.png;100\n", "other.cfg"))


def test_headings_may_come_along(tmp_path):
    found = read_positions(
        listing(tmp_path, "name;x;y;heading_deg\na/1.jpg;1;1;90.5\n2.jpg;2;2;\n3.jpg;3;3;360\n")
    )
    assert [found.heading_of(name) for name in ("1.jpg", "2.jpg", "3.jpg", "4.jpg")] == [
        90.5,
        None,
        0.0,
        None,
    ]
    with pytest.raises(TableError, match="not from 0 to 360") as caught:
        read_positions(listing(tmp_path, "name;lat;lon;heading_deg\n1.jpg;1;1;361\n"))
    assert caught.value.where.endswith(":2")
