"""Files and photos of a folder, in natural order, and suggestions for similar names."""

import time
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.errors import UsageError
from webapp.files import listing
from webapp.files.listing import Spelling, list_files, natural_key, normal_name


def make(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_natural_order_and_all_files(tmp_path):
    names = ["img2.jpg", "IMG10.jpg", "b/1.txt", "b/a/x", "b10/1", "b9/1", "noending"]
    make(tmp_path, *names, ".hidden", ".git/config", "derived/index")
    wanted = ["b/1.txt", "b/a/x", "b9/1", "b10/1", "derived/index", "img2.jpg", "IMG10.jpg", "noending"]
    assert list_files(tmp_path) == wanted
    assert list_files(tmp_path, leave_out=[tmp_path / "derived"]) == [w for w in wanted if "derived" not in w]


def test_links_to_folders_are_not_followed(tmp_path):
    make(tmp_path, "in/a.jpg", "out/b.jpg")
    try:
        (tmp_path / "in" / "link").symlink_to(tmp_path / "out", target_is_directory=True)
    except OSError:
        pytest.skip("this system makes no links")
    assert list_files(tmp_path / "in") == ["a.jpg"]


def test_a_folder_that_is_missing_is_refused(tmp_path):
    with pytest.raises(UsageError):
        list_files(tmp_path / "missing")


@given(st.lists(st.text("aB019²١/é", min_size=1, max_size=6), max_size=8))
def test_any_names_have_one_order(names):
    backwards = names[::-1]
    assert sorted(names, key=natural_key) == sorted(backwards, key=natural_key)


def test_same_name_coded_differently() -> None:
    accent = unicodedata.normalize("NFD", "p/hříště.jpg")
    spelling = Spelling(["p/A.JPG", accent])
    assert spelling.same("p/a.jpg") == "p/A.JPG"
    assert spelling.same(unicodedata.normalize("NFC", accent)) == accent
    assert spelling.same("p/A.JPG") is None
    assert spelling.same("q/a.jpg") is None


def test_similar_names() -> None:
    spelling = Spelling(["p/gate.jpeg", "p/IMG_0012.jpg", "q/twice.jpg", "r/twice.jpg"])
    assert spelling.similar("p/gate.jpg") == "p/gate.jpeg"
    assert spelling.similar("img_0012.jpg") == "p/IMG_0012.jpg"
    assert spelling.similar("p/IMG_0013.jpg") is None, "another number is another photo"
    assert spelling.similar("twice.jpg") is None, "two files have this name"


def test_normal_name() -> None:
    assert normal_name("./a//b.jpg") == "a/b.jpg"


def test_long_names_are_compared_less_often() -> None:
    """Comparing two names takes up to the square of their length."""
    spelling = Spelling([f"p/{'a' * 190}{'bcde'[n % 4]}{'b' * (n // 4)}.jpg" for n in range(60)])
    started = time.process_time()
    for _ in range(400):
        spelling.similar(f"p/{'a' * 190}.jpg")
    assert time.process_time() - started < 10


def test_typing_errors_are_looked_for_only_so_often(monkeypatch):
    monkeypatch.setattr(listing, "_MOST_COMPARISONS", 800)
    spelling = Spelling(["p/gate.jpeg", *(f"p/{'abcdefgh'[i]}.jpg" for i in range(4))])
    assert [spelling.similar("p/gate.jpg") for _ in range(3)] == ["p/gate.jpeg", "p/gate.jpeg", None]
