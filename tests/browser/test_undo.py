"""Undo and redo of every edit, kept across reloads."""

from playwright.sync_api import expect


def test_undo_and_redo_survive_a_reload(make_page, api):
    edit = make_page(3)
    edit.click(200, 200)
    edit.click(400, 300)
    expect(edit.unplaced).to_have_text("1")
    edit.saved()
    both = api.positions(edit.slug)
    edit.open()
    edit.undo.click()
    expect(edit.unplaced).to_have_text("2")
    edit.open()
    expect(edit.unplaced).to_have_text("2")
    edit.undo.click()
    expect(edit.unplaced).to_have_text("3")
    assert api.positions(edit.slug) == {}
    edit.open()
    edit.redo.click()
    expect(edit.unplaced).to_have_text("2")
    edit.page.keyboard.press("Control+y")
    expect(edit.unplaced).to_have_text("1")
    edit.saved()
    assert api.positions(edit.slug) == both


def test_a_new_edit_ends_the_redo(make_page):
    edit = make_page(3)
    edit.click(200, 200)
    edit.page.keyboard.press("Control+z")
    expect(edit.redo).to_be_enabled()
    edit.click(300, 300)
    expect(edit.redo).to_be_disabled()
    expect(edit.undo).to_be_enabled()


def test_undo_after_an_upload_says_that_it_undoes_the_step_before(make_page, small_photos):
    edit = make_page(2)
    edit.click(200, 200)
    edit.saved()
    edit.choose_photos(small_photos[5:6])
    edit.uploaded()
    edit.undo.click()
    result = edit.page.locator(".toast")
    expect(result).to_have_text("Undone: placing 1 photo")
    edit.saved()
    expect(edit.unplaced).to_have_text("3")
    edit.redo.click()
    expect(result).to_have_text("Redone: placing 1 photo")
