"""Exports of the page are read by the command line, and imported again by the page."""

import json
import zipfile

from playwright.sync_api import expect

from tests.browser.app import expmap


def download(page, act, folder):
    """Save what a click downloads."""
    with page.expect_download() as waiting:
        act()
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


def test_the_cfg_passes_the_check_of_the_command_line(make_page, app, tmp_path):
    edit = make_page(4, placed=True)
    path = download(edit.page, edit.page.get_by_test_id("export-cfg").click, tmp_path)
    assert path.suffix == ".cfg"
    there = app.library / edit.slug / "map.cfg"
    assert path.read_bytes() == there.read_bytes()
    report = json.loads(expmap("map", "check", there, "--json", library=app.library))
    assert (report["photos"], report["errors"]) == (4, 0)


def test_a_zip_goes_out_and_comes_back(make_page, api, app, tmp_path):
    edit = make_page(3, placed=True)
    path = tmp_path / "map.zip"
    path.write_bytes(api.call("GET", f"/maps/{edit.slug}/export.zip").body())
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "out")
    (cfg,) = (tmp_path / "out").rglob("map.cfg")
    expmap("map", "check", cfg, library=app.library)
    edit.page.goto("/")
    edit.page.get_by_test_id("import-input").set_input_files(path)
    edit.page.wait_for_url("**/maps/*/edit")
    slug = edit.page.url.split("/")[-2]
    assert slug != edit.slug
    expect(edit.placed).to_have_text("3")
    assert sorted(api.positions(slug).values()) == sorted(api.positions(edit.slug).values()) != []
