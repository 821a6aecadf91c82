"""Localization in the page: by upload, by paste, and by the camera."""

import base64
import csv
import json
import math
import re
import time

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import PATIENCE_MS, WIDE
from tests.browser.ensure_browser import find_browser
from tests.browser.watch import BROWSER_OPTIONS, Watch

RIGHT_WITHIN_PX = 40
"""Tolerance on the sample's image, whose neighbouring photos are 40 to 50 pixels apart."""

QUERY = "query_02.jpg"
PASTE = """
([name, data]) => {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const clipboardData = new DataTransfer();
  clipboardData.items.add(new File([bytes], name, {type: "image/jpeg"}));
  document.body.dispatchEvent(new ClipboardEvent("paste", {clipboardData, bubbles: true, cancelable: true}));
}
"""
COUNT = """
([canvas, [red, green, blue]]) => {
  const {width, height} = document.querySelector(canvas);
  const {data} = document.querySelector(canvas).getContext("2d").getImageData(0, 0, width, height);
  let count = 0;
  for (let n = 0; n < data.length; n += 4) {
    count += data[n] === red && data[n + 1] === green && data[n + 2] === blue && data[n + 3] === 255;
  }
  return count;
}
"""


@pytest.fixture(scope="module")
def truth(sample_folder):
    """True positions of the sample's queries, by file name."""
    with (sample_folder / "queries.csv").open(encoding="utf-8", newline="") as file:
        return {
            line["path"].rpartition("/")[2]: (float(line["x"]), float(line["y"]))
            for line in csv.DictReader(file, delimiter=";")
        }


@pytest.fixture
def queries(sample_folder):
    return sample_folder / "queries"


def open_page(page, slug, api):
    """Open the page Localize of a map that is ready to answer."""
    api.wait_for_jobs(slug)
    page.goto(f"/maps/{slug}/localize")
    expect(page.locator("#map-canvas canvas")).to_be_visible()
    return page


def test_in_a_low_window_the_answer_comes_into_sight(page, api, sample_map, queries):
    page.set_viewport_size({"width": 683, "height": 384})
    open_page(page, sample_map, api)
    page.get_by_test_id("query-input").set_input_files(queries / QUERY)
    expect(entries(page).first).to_be_in_viewport(ratio=0.9)


def entries(page):
    return page.get_by_test_id("hypothesis")


def first_place(page):
    """Return the position of the most probable place, map pixels, and its probability."""
    entry = entries(page).first
    return (
        (float(entry.get_attribute("data-x")), float(entry.get_attribute("data-y"))),
        float(entry.get_attribute("data-probability")),
    )


def is_right(page, truth):
    """Check that the answer is this place, and more probable than "not on this map"."""
    expect(entries(page).first).to_be_visible()
    place, probability = first_place(page)
    assert math.dist(place, truth) < RIGHT_WITHIN_PX
    assert probability > float(page.get_by_test_id("off-map").get_attribute("data-probability"))
    expect(page.locator("#shares")).to_have_text("Probability that it was taken there")


def scale_of(page):
    """Return the colours (RGB) of the probabilities, by percent."""
    scale = page.evaluate("JSON.parse(document.getElementById('colours').textContent).scale")
    return [[int(colour[n : n + 2], 16) for n in (1, 3, 5)] for colour in scale]


def painted(page, canvas_id, colour):
    """Count the pixels of a colour on the canvas of a map's marks."""
    return page.evaluate(COUNT, [f"#{canvas_id} canvas", colour])


def wait_until_painted(page, canvas_id, colour):
    until = time.monotonic() + 60
    while painted(page, canvas_id, colour) <= 50:
        assert time.monotonic() < until, f"{canvas_id} has no mark of colour {colour}"
        page.wait_for_timeout(100)


def choose(page, *paths):
    page.get_by_test_id("query-input").set_input_files(paths)


def test_a_photo_that_is_chosen(page, sample_map, api, queries, truth):
    open_page(page, sample_map, api)
    choose(page, queries / QUERY)
    is_right(page, truth[QUERY])
    expect(page.locator("#query-name")).to_have_text(QUERY)
    expect(page.locator("#matches-view canvas, #matches-view svg").first).to_be_visible()
    expect(page.locator("#coordinates dt").first).to_be_visible()
    assert axe.findings(page) == []


def test_a_photo_that_is_pasted(page, sample_map, api, queries, truth):
    open_page(page, sample_map, api)
    name = "query_05.jpg"
    page.evaluate(PASTE, [name, base64.b64encode((queries / name).read_bytes()).decode()])
    is_right(page, truth[name])


def test_a_photo_that_is_dropped(page, sample_map, api, queries, truth):
    open_page(page, sample_map, api)
    name = "query_03.jpg"
    data = base64.b64encode((queries / name).read_bytes()).decode()
    drop = PASTE.replace("clipboardData", "dataTransfer").replace(
        'ClipboardEvent("paste"', 'DragEvent("drop"'
    )
    page.evaluate(drop, [name, data])
    is_right(page, truth[name])


def test_list_and_colours_agree(page, sample_map, api, queries):
    open_page(page, sample_map, api)
    choose(page, queries / QUERY)
    expect(entries(page).first).to_be_visible()
    listed = page.locator("#hypotheses [data-probability]").evaluate_all(
        "all => all.map((one) => Number(one.dataset.probability))"
    )
    assert listed == sorted(listed, reverse=True)
    assert sum(listed) <= 1 + 1e-6
    scale = scale_of(page)
    colour_of = "one.querySelector('.lo-number').style.backgroundColor"
    shown = entries(page).evaluate_all(
        f"all => all.map((one) => [Number(one.dataset.probability), {colour_of}])"
    )
    shown = [
        (probability, colour) for probability, colour in shown if probability >= 0.05
    ]  # less probable ones are hollow
    assert shown
    for probability, colour in shown:
        assert [int(part) for part in colour[4:-1].split(",")] == scale[round(100 * probability)]


def test_a_photo_from_elsewhere_is_not_on_the_map(page, sample_map, api, queries):
    open_page(page, sample_map, api)
    choose(page, queries / "off_map.jpg")
    off = page.get_by_test_id("off-map")
    expect(off).to_be_visible()
    expect(page.locator(".lo-place--off.is-likely")).to_be_visible()
    expect(page.locator("#verdict")).to_have_text(re.compile("not on this map"))
    assert (
        page.locator("#hypotheses .lo-number").count()
        == page.locator("#hypotheses .lo-number--faint, .lo-number--off").count()
    )
    first = page.get_by_test_id("hypothesis").first
    assert float(off.get_attribute("data-probability")) > float(first.get_attribute("data-probability"))
    expect(page.locator("[data-testid=hypothesis] [aria-pressed=true]")).to_have_count(0)
    expect(page.locator("#adopt")).to_have_count(0)


@pytest.fixture
def copied_map(page, sample_map, api):
    """A copy of the sample map with its index, which a test may change."""
    api.wait_for_jobs(sample_map)
    slug = api.ask("POST", f"/maps/{sample_map}/duplicate", data={"name": "Copy"})["slug"]
    api.wait_for_jobs(slug)
    yield slug
    page.goto("about:blank")  # an open page would request a deleted map
    api.wait_for_jobs(slug)
    api.ask("DELETE", f"/maps/{slug}")


def test_a_confirmed_photo_becomes_an_experience_and_is_indexed_alone(page, copied_map, api, queries, truth):
    open_page(page, copied_map, api)
    name = "query_02.jpg"
    choose(page, queries / name)
    is_right(page, truth[name])
    place, _ = first_place(page)
    before = {job["id"] for job in api.wait_for_jobs(copied_map)}
    page.locator("#adopt").click()
    expect(page.locator("#adopt-actions")).to_contain_text("In the map")
    assert math.dist(api.positions(copied_map)[name], place) < 0.01
    built = [
        job for job in api.wait_for_jobs(copied_map) if job["id"] not in before and job["kind"] == "index"
    ]
    # A job may have been queued again just before it began; the second one has nothing to compute.
    assert sum(job["result"]["computed"] for job in built) == 1
    assert max(job["result"]["photos"] for job in built) == len(api.positions(copied_map))
    page.get_by_role("tab", name="History").click()
    expect(page.locator("#history li").first.get_by_title("In the map")).to_be_visible()
    (id,) = [photo["id"] for photo in api.state(copied_map)["photos"] if photo["name"] == name]
    page.get_by_role("tab", name="Answer").click()
    with (
        page.expect_response(lambda response: "/coordinates?" in response.url),  # the last request
        page.expect_response(lambda response: response.url.endswith("/localize")) as answered,
    ):
        page.locator("#ask-again").evaluate("button => button.form.requestSubmit()")
    answer = json.loads(answered.value.text().split("event: answer\ndata: ")[1])
    assert id in answer["hypotheses"][0]["experiences"]  # the adopted photo now matches itself


def test_the_answer_is_shown_in_the_second_placement_too(page, copied_map, api, queries):
    api.ask("PUT", f"/maps/{copied_map}/placements/Rooms", data={"clusters_px": 150})
    open_page(page, copied_map, api)
    choose(page, queries / QUERY)
    expect(entries(page).first).to_be_visible()
    page.locator("#beside").select_option("Rooms")
    second = page.get_by_role("region", name="The same photos in another placement")
    expect(second.locator("canvas").first).to_be_visible()
    expect(second).to_contain_text("Rooms")
    boxes = [page.locator(f"#{id}").bounding_box() for id in ("map-canvas", "map-canvas-2")]
    assert boxes[1]["x"] >= boxes[0]["x"] + boxes[0]["width"]
    colour = scale_of(page)[round(100 * first_place(page)[1])]
    wait_until_painted(page, "map-canvas", colour)
    wait_until_painted(page, "map-canvas-2", colour)
    assert axe.findings(page) == []


@pytest.fixture
def camera_page(app, browser, owner, queries, tmp_path):
    """A page of a browser whose camera shows one query of the sample all the time."""
    film = tmp_path / "camera.mjpeg"
    film.write_bytes((queries / QUERY).read_bytes())
    camera = (
        "--use-fake-ui-for-media-stream",
        "--use-fake-device-for-media-stream",
        f"--use-file-for-fake-video-capture={film}",
    )
    with browser.browser_type.launch(
        executable_path=find_browser(), args=[*BROWSER_OPTIONS, *camera]
    ) as looking:
        context = looking.new_context(
            base_url=app.url, storage_state=owner, viewport=WIDE, service_workers="block"
        )
        context.set_default_timeout(PATIENCE_MS)
        watch = Watch(context, app.url)
        yield context.new_page()
        context.close()
        watch.check()


def test_the_live_camera_is_followed_and_its_last_picture_kept(camera_page, sample_map, api, truth):
    page = open_page(camera_page, sample_map, api)
    before = len(api.ask("GET", f"/maps/{sample_map}/queries")["queries"])
    page.locator("#live").click()
    is_right(page, truth[QUERY])
    expect(page.locator("#video")).to_be_visible()
    with page.expect_response(lambda response: response.url.endswith("/localize") and response.ok):
        pass  # frames are still localized
    is_right(page, truth[QUERY])
    assert axe.findings(page) == []
    page.locator("#live").click()
    expect(page.locator("#video")).to_be_hidden()
    assert len(api.ask("GET", f"/maps/{sample_map}/queries")["queries"]) == before
    page.get_by_role("button", name="Keep this photo and its answer").click()
    expect(page.locator("#query-menu")).to_be_visible()
    is_right(page, truth[QUERY])
    assert len(api.ask("GET", f"/maps/{sample_map}/queries")["queries"]) == before + 1


def unsure_photo(queries, path):
    """Write an enlarged fifth of a query's width and height: too little for a certain answer."""
    with Image.open(queries / QUERY) as photo:
        width, height = photo.width // 5, photo.height // 5
        photo.crop((0, 2 * height, width, 3 * height)).resize(photo.size).save(path)
    return path


def test_an_unsure_answer_asks_for_more_photos_of_the_spot(page, sample_map, api, queries, truth, tmp_path):
    near, far = queries / QUERY, unsure_photo(queries, tmp_path / "near.jpg")
    open_page(page, sample_map, api)
    choose(page, near)
    expect(entries(page).first).to_be_visible()
    expect(page.get_by_test_id("more-input")).to_have_count(0)
    choose(page, far)
    expect(page.locator("#query-name")).to_have_text("near.jpg")
    more = page.get_by_test_id("more-input")
    expect(more).to_be_attached()
    assert axe.findings(page) == []
    page.reload()
    more.set_input_files([near])
    expect(page.locator("#query-about")).to_contain_text("2 photos from one spot")
    is_right(page, truth[QUERY])
    expect(more).to_have_count(0)
    choose(page, far)
    expect(page.locator("#query-name")).to_have_text("near.jpg")
    more.set_input_files([near])
    expect(page.locator("#query-about")).to_contain_text("2 photos from one spot")


def test_a_file_that_is_no_photo_takes_no_answer_away(context, page, sample_map, api, queries, tmp_path):
    context.watch.expect(422)
    (tmp_path / "notes.jpg").write_text("no photo")
    open_page(page, sample_map, api)
    choose(page, unsure_photo(queries, tmp_path / "near.jpg"))
    page.get_by_test_id("more-input").set_input_files([tmp_path / "notes.jpg"])
    expect(page.get_by_test_id("error-message")).to_contain_text("notes.jpg")
    expect(entries(page).first).to_be_visible()
    expect(page.get_by_test_id("more-input")).to_be_attached()


def test_an_unsure_answer_can_be_looked_at_thoroughly(page, sample_map, api, queries, tmp_path):
    """As with weights installed: here the option is only added to the page, and the request changed."""
    asked = []

    def as_usual(route):
        asked.append(route.request.post_data_buffer)
        route.continue_(post_data=asked[0].replace(b"thorough", b"verified"))

    open_page(page, sample_map, api)
    page.evaluate("document.getElementById('option-method').append(new Option('thorough', 'thorough'))")
    choose(page, unsure_photo(queries, tmp_path / "near.jpg"))
    closer = page.get_by_test_id("look-closer")
    expect(closer).to_be_visible()
    page.route("**/localize", as_usual)
    closer.click()
    expect(page.locator("#options-count")).to_have_text("1")
    expect(entries(page).first).to_be_visible()
    assert len(asked) == 1 and b"thorough" in asked[0]


def test_a_camera_that_was_solved_is_shown_with_its_height_and_tilt(page, sample_map, api, queries):
    camera = {
        "height_px": 1.5,
        "height_m": 0.18,
        "pitch_deg": -2.04,
        "roll_deg": 0.52,
        "covariance": [[0.25 * (row == column) for column in range(6)] for row in range(6)],
        "landmarks": 321,
    }
    open_page(page, sample_map, api)
    expect(page.locator("#option-method option[value=landmarks]")).to_have_count(1)  # made on demand
    photo = {"name": QUERY, "mimeType": "image/jpeg", "buffer": (queries / QUERY).read_bytes()}
    answer = api.ask("POST", f"/maps/{sample_map}/localize", multipart={"file": photo})
    answer["hypotheses"][0] |= {"camera": camera, "radius_px": 10.0, "radius_m": 1.2, "heading_deg": 90.0}
    page.route("**/api/v1/maps/*/localize", lambda route: route.fulfill(json=answer))
    choose(page, queries / QUERY)
    facts = page.locator("#coordinates")
    expect(facts).to_contain_text("0.2 m ± 0.1 m, over the nearest placed camera")
    expect(facts).to_contain_text("90° ± 0.5°")
    expect(facts).to_contain_text("-2° ± 0.5°")
    expect(facts).to_contain_text("321 agree")


def test_several_photos_are_a_table_and_marks_on_the_map(page, api, sample_map, queries, truth):
    open_page(page, sample_map, api)
    names = ["query_01.jpg", QUERY, "off_map.jpg"]
    page.get_by_test_id("query-input").set_input_files([queries / name for name in names])
    page.get_by_role("button", name="Each separately").click()
    rows = page.get_by_test_id("batch-row")
    expect(rows).to_have_count(3)
    expect(page.locator("#batch-count")).to_have_text("3 of 3 localized", timeout=PATIENCE_MS)
    hollow = re.compile("badge--hollow")
    expect(rows.first.locator(".badge")).not_to_have_class(hollow)
    expect(rows.last.locator(".badge")).to_have_class(hollow)
    expect(rows.last.locator(".badge")).to_have_text("not here")
    marks = page.locator("#map-canvas path.leaflet-interactive")
    expect(marks).to_have_count(2)
    with page.expect_download() as download:
        page.get_by_test_id("batch-csv").click()
    lines = list(csv.DictReader(download.value.path().read_text("utf-8").splitlines()))
    assert [line["photo"] for line in lines] == names
    for line in lines[:2]:
        at = float(line["x_px"]), float(line["y_px"])
        assert math.dist(at, truth[line["photo"]]) < RIGHT_WITHIN_PX
    rows.first.get_by_role("button").click()
    expect(page.locator("#query-name")).to_have_text(names[0])
    expect(marks).to_have_count(0)
    page.locator("[data-testid=term-inliers]:visible").first.click()
    expect(page.get_by_role("note").filter(has_text="Inliers")).to_be_visible()
    page.keyboard.press("Escape")
    page.get_by_role("tab", name="History").click()
    expect(page.locator("#history li").first.locator(".badge--hollow")).to_have_text("not here")


WATCH_WORDS = """
() => {
  const bar = document.getElementById("busy");
  window.said = [];
  new MutationObserver(() => {
    const words = document.querySelector("#busy-words [role=status]").textContent;
    const verdict = document.getElementById("verdict").textContent;
    window.said.push([words, bar.value, verdict]);
  }).observe(document.getElementById("busy-words"), { subtree: true, childList: true });
}
"""


def as_events(*events):
    return "".join(f"event: {kind}\ndata: {json.dumps(data)}\n\n" for kind, data in events)


def test_what_is_done_is_said_while_one_waits(page, api, sample_map, queries):
    open_page(page, sample_map, api)
    page.evaluate(WATCH_WORDS)
    held = []
    page.route(re.compile(r"/localize"), lambda route: held.append(route) if not held else route.continue_())
    page.get_by_test_id("query-input").set_input_files(queries / QUERY)
    words = page.locator("#busy-words")
    expect(words).to_contain_text(re.compile(r"(Sending|Reading) the photo"))
    expect(words).to_contain_text(re.compile(r"\d seconds"))
    held[0].continue_()
    expect(words).to_be_hidden(timeout=PATIENCE_MS)
    said = [(words, bar) for words, bar, _ in page.evaluate("said")]
    assert "Comparing with 60 photos of the map" in [words for words, _ in said]
    bars = [bar for words, bar in said if words]
    assert bars == sorted(bars)


def test_the_first_looks_answer_is_shown_until_the_second_ones_comes(page, api, sample_map, queries):
    open_page(page, sample_map, api)
    photo = {"name": QUERY, "mimeType": "image/jpeg", "buffer": (queries / QUERY).read_bytes()}
    answer = api.ask("POST", f"/maps/{sample_map}/localize", multipart={"file": photo})
    place = answer["hypotheses"][0]
    first = answer | {"hypotheses": [place | {"probability": 0.4}], "off_map_probability": 0.3}
    first |= {"other_probability": 0.3, "verdict": "perhaps_place"}
    body = as_events(
        ("progress", {"photos": 60, "done": 0, "total": 1}), ("first", first), ("answer", answer)
    )
    page.route(
        "**/api/v1/maps/*/localize",
        lambda route: route.fulfill(body=body, headers={"Content-Type": "text/event-stream"}),
    )
    page.evaluate(WATCH_WORDS)
    choose(page, queries / QUERY)
    expect(page.locator("#query-about")).not_to_be_empty()
    expect(page.locator("#busy-words")).to_be_hidden()
    final = page.locator("#verdict").inner_text()
    assert first_place(page)[1] == place["probability"]
    assert not final.startswith("Uncertain")
    ((_, bar, _),) = [one for one in page.evaluate("said") if one[0].startswith("This is the first")]
    assert 0.5 < bar < 1


def test_an_error_after_the_first_answer_is_said_and_leaves_it(page, api, sample_map, queries):
    open_page(page, sample_map, api)
    photo = {"name": QUERY, "mimeType": "image/jpeg", "buffer": (queries / QUERY).read_bytes()}
    answer = api.ask("POST", f"/maps/{sample_map}/localize", multipart={"file": photo})
    error = {"code": "disk_full", "message": "the disk is full", "hint": None, "where": None}
    body = as_events(("first", answer), ("error", {"status": 507, "error": error}))
    page.route(
        "**/api/v1/maps/*/localize",
        lambda route: route.fulfill(body=body, headers={"Content-Type": "text/event-stream"}),
    )
    choose(page, queries / QUERY)
    expect(page.get_by_test_id("error-message")).to_contain_text("The disk is full")
    expect(entries(page).first).to_be_visible()
    expect(page.locator("#busy-words")).to_be_hidden()
    assert axe.findings(page) == []
