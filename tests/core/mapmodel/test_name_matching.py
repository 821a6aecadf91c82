"""Matching of names in a list to photos."""

import unicodedata

from webapp.core.mapmodel.name_matching import match_names


def matched(names, *photos):
    """Match names to photos that have one or more names each; ids count from 0."""
    return match_names(names, [(n, (p,) if isinstance(p, str) else p) for n, p in enumerate(photos)])


def test_folders_case_and_coding_play_no_part():
    accent = unicodedata.normalize("NFD", "výlet.jpg")
    found = matched(["photos/IMG_1.JPG", "b\\2.jpg", "./c/výlet.jpg"], "img_1.jpg", "x/y/2.jpg", accent)
    assert found.photo == {"photos/IMG_1.JPG": 0, "b\\2.jpg": 1, "./c/výlet.jpg": 2}
    assert found.unknown == found.ambiguous == ()


def test_folders_distinguish_same_names():
    found = matched(["walk/a/1.jpg", "walk/b/1.jpg"], "b/1.jpg", "a/1.jpg")
    assert found.photo == {"walk/a/1.jpg": 1, "walk/b/1.jpg": 0}


def test_what_could_be_two_photos_is_ambiguous():
    found = matched(["1.jpg"], "b/1.jpg", "a/1.jpg")
    assert (found.photo, found.ambiguous) == ({}, ("1.jpg",))


def test_two_names_for_one_photo_are_ambiguous_unless_one_fits_better():
    assert matched(["a/1.jpg", "b/1.jpg"], "1.jpg").ambiguous == ("a/1.jpg", "b/1.jpg")
    found = matched(["a/1.jpg", "b/1.jpg"], "b/1.jpg")
    assert (found.photo, found.unknown) == ({"b/1.jpg": 0}, ("a/1.jpg",))


def test_a_photo_is_also_found_by_what_it_is_called_in_the_map():
    found = matched(["photos/IMG-0a1b2c3d.jpg"], ("IMG.jpg", "photos/IMG-0a1b2c3d.jpg"))
    assert found.photo == {"photos/IMG-0a1b2c3d.jpg": 0}


def test_names_without_a_photo_are_reported():
    found = matched(["9.jpg", "", "/", ".."], "1.jpg")
    assert found.unknown == ("9.jpg", "", "/", "..")
    assert matched([]).photo == {}
