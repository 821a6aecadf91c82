"""The manual in the program, and the chapters that pages link to."""

import re

import pytest

from tests.pages import addresses
from webapp.render import manual
from webapp.tasks.maps import adopt_map


def test_help_leads_to_the_first_chapter(client):
    assert client.get("/help").location == "/help/make-a-map#1-a-new-map-and-its-image"
    answer = client.get("/help", follow_redirects=True)
    assert answer.status_code == 200 and "Make a map in the browser" in answer.text
    assert answer.text.count('aria-current="page"') >= 1


def test_pictures_are_there_and_nothing_else(client):
    with client.get("/help/pictures/edit.jpg") as picture:
        assert picture.content_type == "image/jpeg"
    assert client.get("/help/pictures/none.jpg").status_code == 404
    assert client.get("/help/pictures/..%2Fdesign.md").status_code == 404
    assert client.get("/help/nothing").status_code == 404


@pytest.mark.parametrize("page", addresses(slug="row", name="photos").values())
def test_the_question_mark_opens_the_chapter_of_the_page(client, library, owner, make_map, page):
    make_map(library.map_folder("row"), 2)
    adopt_map.adopt_map(library, "row", account_id=owner.id)
    (target,) = re.findall(r'href="/help/([^"]*)"[^>]*data-testid="help-link"', client.get(page).text)
    name, _, anchor = target.partition("#")
    html = manual.chapter(name).html
    assert not anchor or f'id="{anchor}"' in html


def test_pages_of_landmarks_have_a_chapter_of_their_own(client, library, owner, make_map):
    make_map(library.map_folder("row"), 2)
    adopt_map.adopt_map(library, "row", account_id=owner.id)
    for page, chapter in (("landmarks", "landmarks-in-3d"), ("control-points", "control-points")):
        assert f'href="/help/landmarks#{chapter}"' in client.get(f"/maps/row/{page}").text
