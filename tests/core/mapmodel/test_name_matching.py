"""Matching of names in a list to photos."""

import itertools
import time
import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from webapp.core.mapmodel.name_matching import match_names

PATHS = st.lists(
    st.lists(st.sampled_from("abc"), min_size=1, max_size=4).map("/".join), max_size=5, unique=True
)


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


def test_many_names_for_many_photos_of_one_name_cost_no_product():
    """Names of a list, all of which match all photos."""
    started = time.process_time()
    found = matched([f"{n}/a.jpg" for n in range(4000)], *(f"p{n}/a.jpg" for n in range(4000)))
    assert len(found.ambiguous) == 4000
    assert time.process_time() - started < 4


def alike(one, other):
    """Count the parts at the end that two paths share."""
    pairs = zip(reversed(one.split("/")), reversed(other.split("/")), strict=False)
    return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))


@given(names=PATHS, photos=PATHS)
def test_it_matches_as_a_comparison_of_all_with_all(names, photos):
    found, names = matched(names, *photos), list(dict.fromkeys(names))
    common = {n: [alike(n, p) for p in photos] for n in names}
    best = {n: max(common[n], default=0) for n in names}
    for n in names:
        ids = [i for i, count in enumerate(common[n]) if count == best[n] > 0]
        rivals = [best[o] for o in names if o != n and ids and common[o][ids[0]] == best[o]]
        if not ids or max(rivals, default=0) > best[n]:
            assert n in found.unknown
        elif len(ids) > 1 or best[n] in rivals:
            assert n in found.ambiguous
        else:
            assert found.photo[n] == ids[0]


def test_a_photo_is_also_found_by_what_it_is_called_in_the_map():
    found = matched(["photos/IMG-0a1b2c3d.jpg"], ("IMG.jpg", "photos/IMG-0a1b2c3d.jpg"))
    assert found.photo == {"photos/IMG-0a1b2c3d.jpg": 0}


def test_names_without_a_photo_are_reported():
    found = matched(["9.jpg", "", "/", ".."], "1.jpg")
    assert found.unknown == ("9.jpg", "", "/", "..")
    assert matched([]).photo == {}
