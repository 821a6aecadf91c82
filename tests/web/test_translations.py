"""Every text of pages and scripts is translated to every language, and compiled catalogues are up to date."""

import ast
import importlib.util
import re
from collections import defaultdict

import pytest
from babel.messages.pofile import read_po

from webapp.web.language import LANGUAGES, TRANSLATIONS, script_catalogue, translate_job

DOMAINS = ("messages", "scripts")
OTHERS = sorted(set(LANGUAGES) - {"en"})
KEPT = re.compile(r"%\(\w+\)[sd]|%[sd]|\{\w*\}|</?\w[^>]*>|&#?\w+;|`[^`]+`")
"""Parts that a translation must contain, too: placeholders, tags, entities, and literal input."""


@pytest.fixture(scope="module")
def maker(request):
    """The script that extracts the texts."""
    path = request.config.rootpath / "docs" / "make_translations.py"
    spec = importlib.util.spec_from_file_location("make_translations", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(params=[(domain, language) for domain in DOMAINS for language in OTHERS])
def written(request):
    """Domain, language, and path of each `.po` file."""
    domain, language = request.param
    return domain, language, TRANSLATIONS / language / "LC_MESSAGES" / f"{domain}.po"


def test_every_text_is_gathered_and_translated(maker, written):
    domain, language, path = written
    now = maker.merged(domain, language)
    assert len(now) > 100
    assert maker.untranslated(now) == [], "fill them in, and run docs/make_translations.py"
    assert maker.po_text(now).decode() == path.read_text("utf-8"), "run docs/make_translations.py"


def test_texts_in_any_place_of_a_script_are_gathered(maker):
    gathered = maker.gathered("scripts")
    calls = re.compile(r'\btn?\(\s*"((?:[^"\\]|\\.)+)"')
    texts = {
        (path.name, text)
        for path in (maker.ROOT / "static" / "js").rglob("*.js")
        for text in calls.findall(path.read_text("utf-8"))
    }
    assert len(texts) > 100
    assert {(name, text) for name, text in texts if text not in gathered} == set()


def test_constant_texts_in_python_are_gathered(maker):
    """Whatever name a module imports a function of flask_babel by."""
    gathered = maker.gathered("messages")
    found = set()
    for path in TRANSLATIONS.parents[1].rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
        babel = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module == "flask_babel"]
        names = {one.asname or one.name for node in babel for one in node.names if "gettext" in one.name}
        calls = [node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
        first = [node.args[0] for node in calls if node.func.id in names and node.args]
        found |= {(path.name, text.value) for text in first if isinstance(text, ast.Constant)}
    assert len(found) > 100
    missing = {(name, text) for name, text in found if text not in gathered}
    assert missing == set(), "name the function in _KEYWORDS of docs/make_translations.py"


def test_what_is_compiled_is_what_is_written(maker, written):
    _domain, language, path = written
    assert path.with_suffix(".mo").read_bytes() == maker.mo_bytes(path.read_bytes(), language)


def test_every_folder_is_a_language_in_its_own_words():
    assert set(OTHERS) == {path.name for path in TRANSLATIONS.iterdir() if path.is_dir()}
    assert next(iter(LANGUAGES)) == "en", "which is what there is where nothing else is preferred"
    assert (LANGUAGES["cs"], LANGUAGES["de"]) == ("Čeština", "Deutsch")


def test_translations_keep_placeholders_and_markup(written):
    _domain, language, path = written
    with path.open("rb") as file:
        messages = [message for message in read_po(file, locale=language) if message.id]
    for message in messages:
        ids = message.id if isinstance(message.id, tuple) else (message.id,)
        strings = message.string if isinstance(message.string, tuple) else (message.string,)
        # the first form may spell out "one"; the last one is for many
        assert sorted(KEPT.findall(strings[-1])) == sorted(KEPT.findall(ids[-1])), message.id
        for string in strings:
            assert set(KEPT.findall(string)) <= set(KEPT.findall(ids[-1])), message.id
            assert string.strip() == string, message.id
            if message.python_format:
                assert string % defaultdict(str) is not None, "a percent sign is written twice"


def test_texts_that_change_are_noticed(maker, tmp_path, monkeypatch):
    folder = tmp_path / "cs" / "LC_MESSAGES"
    folder.mkdir(parents=True)
    monkeypatch.setattr(maker, "TRANSLATIONS", tmp_path)
    (folder / "scripts.po").write_text('msgid "gone"\nmsgstr "pryč"\n')
    merged = maker.merged("scripts", "cs")
    assert "gone" not in merged
    assert "Cancel" in maker.untranslated(merged)


def test_pages_are_in_the_language_that_is_asked_for(client, stranger):
    assert "<h1>Mapy</h1>" in client.get("/", headers={"Accept-Language": "cs"}).text
    assert "<h1>Maps</h1>" in client.get("/", headers={"Accept-Language": "fi, en;q=0.5"}).text
    assert "<h1>Přihlásit se</h1>" in stranger.get("/sign-in", headers={"Accept-Language": "cs"}).text


@pytest.mark.parametrize(
    ("asked", "language"),
    [
        ("cs-CZ", "cs"),
        ("CS", "cs"),
        ("en-GB, cs;q=0.8", "en"),
        ("fi, cs-CZ;q=0.2", "cs"),
        ("de-AT, en;q=0.8", "de"),
        ("en;q=0.1, cs;q=0.9", "cs"),
        ("cs;q=0, *", "en"),
        ("fi", "en"),
        ("", "en"),
    ],
)
def test_regions_weights_and_unknown_languages(stranger, asked, language):
    assert f'<html lang="{language}"' in stranger.get("/sign-in", headers={"Accept-Language": asked}).text


def test_every_language_can_be_chosen(client):
    account = client.get("/account").text
    for code, name in LANGUAGES.items():
        assert re.search(f'<button name="language" value="{code}" lang="{code}"[^>]*>{name}<', account)
        assert re.search(f'<option value="{code}" lang="{code}"[^>]*>{name}<', account)


def test_errors_are_translated_too(client):
    result = client.get("/api/v1/jobs?map=none", headers={"Accept-Language": "cs"}).json["error"]
    assert result["message"] == "taková mapa neexistuje, nebo s vámi není sdílena"


def test_steps_and_errors_of_jobs_are_translated(app):
    error = {"message": "internal error", "hint": None, "where": "photo_01.jpg"}
    with app.test_request_context(headers={"Accept-Language": "cs"}):
        job = translate_job({"id": 7, "note": "describing photos", "error": error})
        assert translate_job({"note": "", "error": None}) == {"note": "", "error": None}
    assert (job["id"], job["note"]) == (7, "popisují se fotky")
    assert job["error"] == error | {"message": "na serveru se něco pokazilo"}


def test_scripts_get_their_words_with_the_page(app):
    with app.test_request_context(headers={"Accept-Language": "cs"}):
        catalogue = script_catalogue()
    assert catalogue["language"] == "cs"
    assert catalogue["messages"]["Cancel"] == "Zrušit"
    assert catalogue["messages"]["{n} second"] == ["{n} sekunda", "{n} sekundy", "{n} sekund"]
    assert len(catalogue["plurals"]) == 3
    with app.test_request_context(headers={"Accept-Language": "en"}):
        assert script_catalogue()["messages"] == {}


@pytest.mark.parametrize("language", OTHERS)
def test_each_plural_form_is_for_a_plural_of_its_own(app, language):
    with app.test_request_context(headers={"Accept-Language": language}):
        catalogue = script_catalogue()
    assert len(set(catalogue["plurals"])) == len(catalogue["messages"]["{n} second"])
    assert {"one", "other"} <= set(catalogue["plurals"])


def test_no_translated_text_is_in_an_f_string():
    """The texts are gathered by Babel, which does not look into f-strings."""
    names = {"_", "gettext", "ngettext", "lazy_gettext"}
    found = [
        f"{path}:{node.lineno}"
        for path in TRANSLATIONS.parents[1].rglob("*.py")
        for outer in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(outer, ast.JoinedStr)
        for node in ast.walk(outer)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names
    ]
    assert found == []


def test_jobs_say_what_they_do_in_plain_words(app):
    with app.test_request_context(headers={"Accept-Language": "en"}):
        said = [
            translate_job({"note": note, "error": None})["note"]
            for note in ("training", "second look: xfeat")
        ]
    assert said == ["learning what the photos look like", "the same for a second look at difficult photos"]
