"""The files of pages: few, compressed, and cached by browsers until their content changes."""

import gzip
import re
import shutil

import pytest

from webapp.resources import resource_folder
from webapp.web import static_files

GZIP = {"Accept-Encoding": "gzip, deflate, br"}
ADDRESS = re.compile(r'(?:src|href)="(/static/[^"#]+)')


@pytest.fixture
def addresses(client, park):
    """The addresses of the files of the editor."""
    return list(dict.fromkeys(ADDRESS.findall(client.get("/maps/park/edit").text)))


def test_a_page_asks_for_few_files(addresses):
    assert 3 <= len(addresses) <= 8


def test_browsers_keep_the_files_of_the_present_version(stranger, addresses):
    for address in addresses:
        with stranger.get(address) as answer:
            assert answer.status_code == 200, address
            assert answer.headers["Cache-Control"] == "public, max-age=31536000, immutable"


def test_under_the_address_of_another_version_they_do_not(stranger, addresses):
    for address in addresses:
        with stranger.get(re.sub("/static/[^/]+", f"/static/{'0' * 16}", address)) as answer:
            assert (answer.status_code, answer.headers["Cache-Control"]) == (200, "no-cache")


def test_text_is_compressed_for_those_who_take_it(stranger, addresses):
    scripts = [address for address in addresses if address.endswith((".js", ".css", ".svg"))]
    assert len(scripts) >= 3
    for address in scripts:
        with stranger.get(address) as plain, stranger.get(address, headers=GZIP) as packed:
            assert "Content-Encoding" not in plain.headers and packed.headers["Content-Encoding"] == "gzip"
            assert gzip.decompress(packed.data) == plain.data
            assert plain.mimetype == packed.mimetype
            assert "Accept-Encoding" in plain.vary and "Accept-Encoding" in packed.vary
    assert sum(len(stranger.get(address, headers=GZIP).data) for address in scripts) < 160_000


@pytest.mark.parametrize(
    "name",
    ["js/no.js", "../pyproject.toml", "bundles/js/no.js", "bundles/../../x.js", "bundles/js/editor/main.py"],
)
def test_nothing_else_is_sent(stranger, addresses, name):
    version = addresses[0].split("/")[2]
    assert stranger.get(f"/static/{version}/{name}").status_code == 404


def test_another_content_is_another_version(app, tmp_path, monkeypatch):
    copy = tmp_path / "static"
    shutil.copytree(resource_folder("static"), copy)
    monkeypatch.setattr(app, "static_folder", str(copy))

    def version():
        with app.app_context():
            return static_files.version()

    before = version()
    assert version() == before
    (copy / "js" / "shared" / "shell.js").write_text("// other\n")
    changed = version()
    (copy / "js" / "sw.js").write_text("// the worker itself is none of them\n")
    assert before != changed == version()


def test_the_icon_is_where_old_browsers_look(stranger):
    with stranger.get("/favicon.ico") as icon:
        assert icon.status_code == 200 and icon.data.startswith(b"\x89PNG")


def test_each_module_is_in_a_bundle_once_and_after_what_it_imports(tmp_path):
    (tmp_path / "a.js").write_text('import { b } from "./b.js";\nimport { c as d } from "./c.js";\nb(d);\n')
    (tmp_path / "b.js").write_text('import "./c.js";\nexport function b() {}\n')
    (tmp_path / "c.js").write_text("export const c = 1;\n")
    made = static_files.bundle_scripts(tmp_path, ["b.js", "a.js"])
    assert re.findall(r"^// (\w)\.js$", made, re.M) == ["c", "b", "a"]
    assert "const { c: d } = $$0;" in made and "$$1 = { b };" in made
    assert "import" not in made and "export" not in made


def test_libraries_stay_imports_each_once(tmp_path):
    (tmp_path / "a.js").write_text('import { Box, Line as Bar } from "three";\nexport const a = Bar;\n')
    (tmp_path / "b.js").write_text('import { a } from "./a.js";\nimport { Box } from "three";\nnew Box(a);\n')
    made = static_files.bundle_scripts(tmp_path, ["b.js"])
    assert made.startswith('import * as $lib0 from "three";\n// a.js\n')
    assert made.count("import ") == 1
    assert "const { Box, Line: Bar } = $lib0;" in made
    assert "const { Box } = $lib0;" in made


def test_indentation_and_comments_of_whole_lines_are_left_out_and_nothing_else(tmp_path):
    source = (
        "/** What it is.\n * @param {*} a\n */\nexport function b(a) { // why\n  // what\n"
        '  return a /* here */ + "// no comment";\n}\n/* one line */\nb(1);\n'
    )
    (tmp_path / "a.js").write_text(source)
    made = static_files.bundle_scripts(tmp_path, ["a.js"])
    body = 'function b(a) { // why\nreturn a /* here */ + "// no comment";\n}\nb(1);\n'
    assert made == f"// a.js\nlet $$0;\n{{\n{body}\n$$0 = {{ b }};\n}}\n"
    (tmp_path / "a.css").write_text("/* why\n */\na { color: red; } /* here */\n  /* b */\nb { top: 0; }\n")
    sheet = static_files.bundle_sheets(tmp_path, ["a.css"], base="/")
    assert sheet == "a { color: red; } /* here */\nb { top: 0; }\n\n"


def test_no_text_of_a_script_loses_a_line_for_a_comment():
    texts = re.compile(r"`[^`]*`")
    for path in sorted((resource_folder("static") / "js").rglob("*.js")):
        source = path.read_text("utf-8")
        kept = [re.sub(r"\n[ \t]+", "\n", text) for text in texts.findall(source)]
        assert set(texts.findall(static_files.shortened(source))) <= set(kept), path.name


@pytest.mark.parametrize(
    "source",
    ["export default 1;", "export let a = 1;", 'const a = await import("./b.js");', "import.meta.url;"],
)
def test_a_module_that_cannot_be_bundled_is_refused(tmp_path, source):
    (tmp_path / "a.js").write_text(source)
    with pytest.raises(ValueError, match=r"a\.js"):
        static_files.bundle_scripts(tmp_path, ["a.js"])


def test_pictures_of_style_sheets_are_found(stranger, addresses):
    (sheet,) = [address for address in addresses if address.endswith(".css")]
    with stranger.get(sheet) as answer:
        pictures = re.findall(r"url\((/static/[^)]+)\)", answer.text)
    assert pictures
    for picture in pictures:
        with stranger.get(picture) as answer:
            assert answer.status_code == 200
