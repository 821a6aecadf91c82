"""Two tabs on one map: changes of one appear in the other, and no work is lost silently."""

import math

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import EditPage, spots

pytestmark = pytest.mark.slow


def test_what_one_does_the_other_sees(make_page, context):
    one = make_page(3)
    two = EditPage(context.new_page(), one.slug).open()
    expect(two.unplaced).to_have_text("3")
    one.click(200, 200)
    expect(two.unplaced).to_have_text("2")


def test_a_conflict_is_reported_and_nothing_is_overwritten(make_page, context, api):
    one = make_page(2, placed=True)
    two = EditPage(context.new_page(), one.slug).open()
    context.watch.expect(409, 412)
    two.page.route("**/changes?*", lambda route: None)  # it receives no changes for a while
    one.drag(spots(1)[0], (300, 500))
    one.saved()
    with two.page.expect_response("**/experiences*") as refused:
        two.drag(spots(1)[0], (700, 600))
    assert refused.value.status in (409, 412)
    two.page.unroute("**/changes?*")
    expect(two.error).to_be_visible()
    (first, _) = api.state(one.slug)["photos"]
    assert math.dist((first["x_px"], first["y_px"]), (300, 500)) < 2
    two.click(300, 500)  # shown where the other tab placed it, and can be moved again
    two.drag((300, 500), (700, 600))
    two.saved()
    (first, _) = api.state(one.slug)["photos"]
    assert math.dist((first["x_px"], first["y_px"]), (700, 600)) < 2
