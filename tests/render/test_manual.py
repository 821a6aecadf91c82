"""The documentation as pages of the program."""

import re

import pytest

from webapp.errors import NotFound
from webapp.render import manual

NAMES = [name for names in manual.CHAPTERS.values() for name in names]


@pytest.mark.parametrize("name", NAMES)
def test_links_and_pictures_of_a_chapter_lead_somewhere(name):
    chapter = manual.chapter(name)
    assert chapter.title
    for target in re.findall(r'href="([^"]*)"', chapter.html):
        if target.startswith("http"):
            continue
        page, _, anchor = target.partition("#")
        found = manual.chapter(page.removeprefix("/help/")) if page else chapter
        assert not anchor or f'id="{anchor}"' in found.html, target
    for source in re.findall(r'src="([^"]*)"', chapter.html):
        assert source.startswith("/help/pictures/")
        assert (manual.folder() / "pictures" / source.rsplit("/", 1)[1]).is_file()


def test_tables_are_tables_and_markup_is_no_markup():
    assert "<table" in manual.chapter("photos").html
    assert "<script" not in "".join(manual.chapter(name).html for name in NAMES)


def test_other_files_are_no_chapters():
    for name in ("SECURITY", "../README", "make_screenshots"):
        with pytest.raises(NotFound):
            manual.chapter(name)


def test_the_manual_has_what_the_site_of_the_documentation_has_for_users():
    _, nav = (manual.folder().parent / ".mkdocs.yml").read_text("utf-8").split("\nnav:\n")
    for_users = nav.partition("  - Development:")[0]
    pages = set(re.findall(r": ([\w-]+)\.md$", for_users, re.M)) - {"README", "FORMAT"}
    assert pages == set(NAMES)


def test_numbers_in_tables_are_aligned_without_inline_styles():
    html = manual.chapter("measurements").html
    assert "style=" not in html
    assert '<td class="manual__number">' in html
