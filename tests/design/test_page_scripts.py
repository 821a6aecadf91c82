"""The scripts of pages keep to their folders: no import cycles, and shared ones are in `shared/`."""

import re

import pytest

from webapp.web.pages import ACCEPTED
from webapp.web.static_files import EVERY_SCRIPT, LIBRARIES, bundle_scripts

IMPORT = re.compile(r'^(?:import|export)\s(?:[^;"]*?\sfrom\s)?"([^"]+)";', re.M)
SCRIPT_LIST = re.compile(r"{% set scripts = (.*?) %}")
FILE_FIELD = re.compile(r'<input[^>]*type="file"[^>]*>')
DERIVED = re.compile(r'accept="\{\{ accepted\.(\w+) \}\}"')
TYPED_SUFFIXES = re.compile(r"accept: [\"'`]|[\"'`]\.\w+, *\.\w+|\\\.\(\w+(\|\w+)+\)\$")
NETWORK = re.compile(r"\bfetch\(|XMLHttpRequest|EventSource\(|sendBeacon|WebSocket\(")


@pytest.fixture(scope="module")
def folder(project):
    """The folder of the scripts."""
    return project / "static" / "js"


@pytest.fixture(scope="module")
def imports(folder):
    """Return the imports of each module, as paths below `static/js`."""
    found = {}
    for path in folder.rglob("*.js"):
        names = [name for name in IMPORT.findall(path.read_text("utf-8")) if name not in LIBRARIES]
        targets = [(path.parent / name).resolve() for name in names]
        found[path.relative_to(folder).as_posix()] = [t.relative_to(folder).as_posix() for t in targets]
    return found


def test_imports_are_seen(imports):
    assert len(imports) > 80
    assert "shared/api.js" in imports["editor/endpoints.js"]


def test_what_is_imported_exists(imports):
    wanted = {target for targets in imports.values() for target in targets}
    assert wanted - set(imports) == set()


def test_imports_form_no_cycle(imports):
    left = {name: set(targets) for name, targets in imports.items()}
    while leaves := {name for name, targets in left.items() if not targets & set(left)}:
        left = {name: targets for name, targets in left.items() if name not in leaves}
    assert left == {}, "these modules are on an import cycle, or import one that is"


def test_pages_import_from_their_own_room_and_from_shared_only(imports):
    def folder(name):
        return name.partition("/")[0]

    across = [
        f"{name} imports {target}"
        for name, targets in imports.items()
        for target in targets
        if folder(target) not in (folder(name), "shared")
    ]
    assert across == []


def test_only_one_module_talks_to_the_server(folder, imports):
    talking = {name for name in imports if NETWORK.search((folder / name).read_text("utf-8"))}
    assert talking == {"shared/api.js", "sw.js"}


def test_every_script_is_loaded_by_a_page(project, folder, imports):
    pages = "".join(path.read_text("utf-8") for path in (project / "templates").rglob("*.html"))
    lists = " ".join(SCRIPT_LIST.findall(pages))
    entries = {f"{name}.js" for name in (*EVERY_SCRIPT, *re.findall(r'"([^"]+)"', lists))}
    assert entries and entries <= set(imports)
    reached, new = set(), set(entries)
    while new:
        reached |= new
        new = {target for name in new for target in imports[name]} - reached
    assert set(imports) - reached == {"sw.js"}


def test_every_script_can_be_a_part_of_a_bundle(folder, imports):
    modules = sorted(set(imports) - {"sw.js"})
    made = bundle_scripts(folder, modules)
    assert sorted(re.findall(r"^// ([\w/-]+\.js)$", made, re.M)) == modules


def test_script_names_are_lower_case_with_hyphens(imports):
    plain = re.compile(r"(?:[a-z]+/)*[a-z0-9]+(?:-[a-z]+)*\.js")
    assert [name for name in imports if not plain.fullmatch(name)] == []


def test_what_file_fields_accept_comes_from_the_formats_of_the_server(project, folder, imports):
    """A format is accepted everywhere once it is read: no template or script lists suffixes by hand."""
    named = set()
    for path in (project / "templates").rglob("*.html"):
        for field in FILE_FIELD.findall(path.read_text("utf-8")):
            found = DERIVED.search(field)
            named |= {found[1]} if found else set()
            is_camera, is_folder = 'accept="image/*" capture=' in field, "webkitdirectory" in field
            assert found or is_camera or is_folder, f"{path.name}: {field}"
    scripts = {name: (folder / name).read_text("utf-8") for name in imports}
    assert {name: hit[0] for name, text in scripts.items() if (hit := TYPED_SUFFIXES.search(text))} == {}
    for text in scripts.values():
        named |= {*re.findall(r"ACCEPTED\.(\w+)", text), *re.findall(r'isAmong\(\w+, "(\w+)"\)', text)}
    assert named == set(ACCEPTED)


def test_pages_whose_scripts_need_what_is_accepted_have_it_in_their_data(project, imports):
    def reached(entry):
        found, new = set(), {entry}
        while new:
            found |= new
            new = {target for name in new for target in imports[name]} - found
        return found

    needing = set()
    for path in (project / "templates").rglob("*.html"):
        text = path.read_text("utf-8")
        entries = [
            f"{name}.js" for found in SCRIPT_LIST.findall(text) for name in re.findall(r'"([^"]+)"', found)
        ]
        if any("shared/accepted.js" in reached(entry) for entry in entries):
            needing.add(path.name)
            assert '"accepted": accepted' in text, path.name
    assert "editor.html" in needing
