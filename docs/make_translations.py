"""Bring the translations up to date: `python docs/make_translations.py`.

Gathers every text from the pages, the scripts, the errors, the answers and the steps of jobs, adds
the new ones to the `.po` files below `webapp/web/translations`, and makes the `.mo` files. Then fill in what
the `.po` files lack (a text editor or Poedit does) and run it again: it prints how many are still without a
translation.
"""

from __future__ import annotations

import ast
import io
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import click
from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

from webapp import errors
from webapp.core.hypotheses.verdict import SENTENCES
from webapp.core.mapmodel.model import FACTS
from webapp.tasks.operate.models import PURPOSES

ROOT = Path(__file__).resolve().parents[1]
TRANSLATIONS = ROOT / "webapp" / "web" / "translations"
DOMAINS = ("messages", "scripts")

_PAGES = {
    "webapp/web": [("**.py", "python")],
    "webapp/missions/web": [("**.py", "python")],
    "webapp/connect": [("**.py", "python")],
    "webapp/missions/render": [("report.py", "python")],
    "templates": [("**.html", "jinja2")],
}
_SCRIPTS = {"static/js": [("**.js", "javascript")]}
_KEYWORDS: dict[str, tuple[int, ...] | None] = {
    "_": None,
    "_l": None,
    "gettext": None,
    "lazy_gettext": None,
    "ngettext": (1, 2),
}
_SCRIPT_KEYWORDS: dict[str, tuple[int, ...] | None] = {"t": None, "tn": (1, 2)}
_HEADER = "# Texts are gathered by docs/make_translations.py; translations are written by hand."
_CHANGING = ("POT-Cre", "PO-Rev", "Generated", "Project-Id", "Report-Msg", "Last-Tr", "Language-T")
"""Fields of the header that say nothing, or another thing each time."""

_NO_DATE = datetime(1970, 1, 1, tzinfo=UTC)

_WITH_ERRORS = {"decode.py", "events", "forms", "libraries", "oidc", "passkeys", "store", "tasks", "web"}
"""Layers, here and in the missions wing, the module that reads images, and connections: their errors are
translated when they are shown."""

_IN_JOBS = {"jobs", "jobs.py", "sample", "tasks"}
"""Where work of jobs says what it is doing; maintenance of the library from the command line does not."""


def gathered(domain: str) -> Catalog:
    """Gather the texts of a domain: `messages` of pages, errors and jobs, or `scripts`."""
    pages = domain == "messages"
    catalog = Catalog(domain=domain, fuzzy=False)
    for folder, methods in (_PAGES if pages else _SCRIPTS).items():
        keywords = _KEYWORDS if pages else _SCRIPT_KEYWORDS
        options = {
            "**.html": {"trimmed": "true", "silent": "false"},
            "**.js": {"parse_template_string": "true"},
        }
        found = extract_from_dir(ROOT / folder, methods, options, keywords, comment_tags=())
        for file, _line, message, _comments, context in found:
            catalog.add(message, locations=[(f"{folder}/{file}", 1)], context=context)
    if pages:
        for text, place in sorted({*_of_errors(), *_of_jobs(), *_of_answers(), *_of_models(), *_of_facts()}):
            catalog.add(text, locations=[(place, 1)])
    return catalog


def merged(domain: str, language: str) -> Catalog:
    """Give the translations of a domain: those there are, and the new texts without one."""
    path = _path(domain, language)
    known = read_po(io.BytesIO(path.read_bytes() if path.exists() else b""), locale=language, domain=domain)
    known.update(gathered(domain), no_fuzzy_matching=True)
    known.obsolete.clear()
    known.fuzzy = False
    known.header_comment = _HEADER
    return known


def po_text(catalog: Catalog) -> bytes:
    """Write a `.po` file that is the same for the same texts: no dates, no line numbers, sorted."""
    out = io.BytesIO()
    write_po(out, catalog, sort_output=True, omit_header=False, width=110, no_location=True)
    lines = out.getvalue().decode().splitlines()
    kept = [line for line in lines if not line.startswith(tuple(f'"{field}' for field in _CHANGING))]
    return ("\n".join(kept) + "\n").encode()


def mo_bytes(po: bytes, language: str) -> bytes:
    """Compile a `.po` file."""
    out = io.BytesIO()
    catalog = read_po(io.BytesIO(po), locale=language)
    catalog.creation_date = catalog.revision_date = _NO_DATE
    write_mo(out, catalog)
    return out.getvalue()


def untranslated(catalog: Catalog) -> list[str]:
    """List the texts that lack a translation, or one of its plural forms."""
    return [
        str(message.id)
        for message in catalog
        if message.id and not all(message.string if isinstance(message.string, tuple) else (message.string,))
    ]


def _of_errors() -> Iterator[tuple[str, str]]:
    """Find what errors are raised with: constant messages and hints."""
    kinds = {name for name, kind in vars(errors).items() if isinstance(kind, type)}
    for path in sorted((ROOT / "webapp").rglob("*.py")):
        place = path.relative_to(ROOT)
        if not _WITH_ERRORS & set(place.parts[1:3]):
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in kinds:
                texts = [*node.args[:1], *(k.value for k in node.keywords if k.arg == "hint")]
                for part in texts:
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        yield part.value, place.as_posix()


def _of_jobs() -> Iterator[tuple[str, str]]:
    """Find the constant texts that jobs give as what they are doing."""
    for path in sorted((ROOT / "webapp").rglob("*.py")):
        place = path.relative_to(ROOT)
        if not _IN_JOBS & set(place.parts[1:3]) or "operate" in place.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("progress.note"):
                given = node.args[0]
                for part in [given.body, given.orelse] if isinstance(given, ast.IfExp) else [given]:
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        yield part.value, place.as_posix()


def _of_answers() -> Iterator[tuple[str, str]]:
    """Give the sentences that answers are said in."""
    for text in SENTENCES.values():
        yield text, "webapp/core/hypotheses/verdict.py"


def _of_models() -> Iterator[tuple[str, str]]:
    """Give what each model is for."""
    for text in PURPOSES.values():
        yield text, "webapp/tasks/operate/models.py"


def _of_facts() -> Iterator[tuple[str, str]]:
    """Give the labels of the facts of photos."""
    for fact in FACTS.values():
        if fact.label:
            yield fact.label, "webapp/core/mapmodel/model.py"


def _path(domain: str, language: str) -> Path:
    return TRANSLATIONS / language / "LC_MESSAGES" / f"{domain}.po"


def main() -> None:
    """Bring all languages up to date."""
    for folder in sorted(path for path in TRANSLATIONS.iterdir() if path.is_dir()):
        for domain in DOMAINS:
            catalog = merged(domain, folder.name)
            po = po_text(catalog)
            _path(domain, folder.name).write_bytes(po)
            _path(domain, folder.name).with_suffix(".mo").write_bytes(mo_bytes(po, folder.name))
            missing = len(untranslated(catalog))
            click.echo(f"{folder.name} {domain}: {len(catalog)} texts, {missing} without a translation")


if __name__ == "__main__":
    main()
