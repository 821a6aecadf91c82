"""Photos in a folder, and names that nearly fit."""

import unicodedata

from webapp.files.listing import Spelling, normal_name


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
