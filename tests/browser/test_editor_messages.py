"""Messages of the editor: what was not done, and how to undo what was."""

from playwright.sync_api import expect


def test_a_double_click_places_one_photo(make_page, api):
    edit = make_page(3)
    edit.page.mouse.dblclick(*edit.screen(300, 300))
    expect(edit.unplaced).to_have_text("2")
    edit.click(500, 300)
    expect(edit.unplaced).to_have_text("1")
    edit.saved()
    assert len(api.positions(edit.slug)) == 2


def test_what_is_not_done_is_said(make_page, api):
    edit = make_page(2)
    said = edit.page.locator(".toast")
    box = edit.canvas.bounding_box()
    edit.page.mouse.click(box["x"] + 5, box["y"] + box["height"] / 2)
    expect(said).to_contain_text("outside the image")
    edit.click(300, 300)
    expect(said).to_have_count(0)
    heading = edit.page.locator("#current-heading")
    for text in ("abc", "400"):
        heading.fill(text)
        heading.press("Enter")
        expect(said).to_contain_text(text)
        expect(heading).to_have_value("")
    heading.fill("-90")
    heading.press("Enter")
    expect(said).to_have_count(0)
    edit.saved()


def test_removed_photos_come_back_by_a_button_and_counts_are_true(make_page, api, small_photos):
    edit = make_page(0)
    edit.choose_photos(small_photos[:3])
    summary = edit.page.get_by_test_id("upload-summary")
    expect(summary).to_contain_text("3 photos wait in the tray")
    edit.click(300, 300)
    expect(summary).to_contain_text("2 photos wait in the tray")
    edit.page.locator("#tray-list").press("Control+a")
    edit.page.locator("#selection-remove").click()
    toast = edit.page.locator(".toast")
    expect(toast).to_contain_text("2 photos removed.")
    toast.get_by_role("button", name="Undo").click()
    expect(edit.unplaced).to_have_text("2")
    edit.saved()
    assert len(api.ask("GET", f"/maps/{edit.slug}")["photos"]) == 3


def test_pictures_that_an_outage_has_broken_come_back(make_page):
    edit = make_page(1)
    page, image = edit.page, edit.tray.first.locator("img")
    page.route("**/thumb*", lambda route: route.abort())
    image.evaluate("image => image.setAttribute('src', image.src + '?again')")
    loaded = "image => image.decode().then(() => true, () => false)"
    assert not image.evaluate(loaded)
    page.unroute("**/thumb*")
    page.evaluate("dispatchEvent(new Event('online'))")
    assert image.evaluate(loaded)
    page.context.watch.faults[:] = [f for f in page.context.watch.faults if "ERR_FAILED" not in f]
