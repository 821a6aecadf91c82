"""A list of positions in the editor: a preview is shown before anything moves."""

import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.slow


def test_a_list_is_shown_before_it_places(make_page, context, api, tmp_path):
    edit = make_page(3)
    context.watch.expect(422)  # while the columns are unknown
    names = sorted(edit.tray_names())
    edit.click(200, 200)
    expect(edit.unplaced).to_have_text("2")
    edit.saved()
    placed = next(iter(api.positions(edit.slug)))
    rows = [f"{name}|{100 + 50 * n}|90" for n, name in enumerate(names)]
    path = tmp_path / "list.txt"
    path.write_text("\n".join(["was|quer|runter", *rows, "other.jpg|1|1"]))
    edit.page.locator("#place-menu summary").click()
    edit.page.locator("#place-by-file").click()
    edit.page.get_by_test_id("list-file").set_input_files(path)
    expect(edit.page.get_by_test_id("list-outcome")).to_contain_text("which columns")
    for field, column in (("name", "was"), ("x", "quer"), ("y", "runter")):
        edit.page.locator(f"#column-{field}").select_option(label=column)
    outcome, place = edit.page.get_by_test_id("list-outcome"), edit.page.get_by_test_id("list-place")
    expect(place).to_have_text("Place 2 photos")
    expect(outcome).to_contain_text("Elsewhere now: 1")
    expect(outcome).to_contain_text("Listed, but no photo has this name: 1")
    assert len(api.positions(edit.slug)) == 1, "so far it is only shown"
    place.click()
    expect(edit.unplaced).to_have_text("0")
    assert abs(api.positions(edit.slug)[placed][0] - 200) < 2, "what has a place stays"
    edit.page.get_by_role("button", name=re.compile("Close|Undo")).first.wait_for()


def test_headers_that_only_the_server_knows_need_no_choice(make_page, tmp_path):
    edit = make_page(2)
    names = sorted(edit.tray_names())
    rows = [f"{name};{100 + 50 * n};90" for n, name in enumerate(names)]
    path = tmp_path / "liste.csv"
    path.write_text("\n".join(["sep=;", "Dateiname;x;y", *rows]))
    edit.page.locator("#place-menu summary").click()
    edit.page.locator("#place-by-file").click()
    edit.page.get_by_test_id("list-file").set_input_files(path)
    expect(edit.page.get_by_test_id("list-place")).to_have_text("Place 2 photos")
