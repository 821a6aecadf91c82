"""Links in the documentation have targets, and its commands are valid."""

import re
import shlex

import click
import pytest

from docs import make_screenshots
from webapp.app.main import root


@pytest.fixture(scope="module")
def pages(tracked):
    """All Markdown files."""
    return {path: path.read_text("utf-8") for path in tracked if path.suffix == ".md"}


def anchors(text):
    """Return the anchors of the headings of a page, as usually generated."""
    plain = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", plain, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def links(text):
    """Return the targets of links and pictures that are not URLs."""
    plain = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"!?\[[^\]]*\]\(([^)\s]+)\)", plain)
    return [target for target in targets if not re.match(r"[a-z]+:", target)]


def test_links_lead_somewhere(pages):
    broken = []
    for path, text in pages.items():
        for target in links(text):
            name, _, anchor = target.partition("#")
            page = path.parent / name if name else path
            if not page.exists() or (anchor and anchor not in anchors(page.read_text("utf-8"))):
                broken.append(f"{path.name}: {target}")
    assert broken == []


def test_every_picture_is_shown(pages, tracked, project):
    """... and every screenshot that is made, is one of them."""
    folder = project / "docs" / "pictures"
    kept = {path.name for path in tracked if path.parent == folder}
    shown = {(page.parent / target).resolve() for page, text in pages.items() for target in links(text)}
    assert kept - {path.name for path in shown if path.parent == folder} == set()
    made = {f"{name}{look}.jpg" for name, (_, looks) in make_screenshots.PAGES.items() for look in looks}
    assert made <= kept


def test_every_page_can_be_reached_from_the_readme(pages, project):
    reached, todo = set(), [project / "README.md"]
    while todo:
        page = todo.pop().resolve()
        if page in reached or page not in pages:
            continue
        reached.add(page)
        todo += [page.parent / target.partition("#")[0] for target in links(pages[page])]
    missing = {p.name for p in set(pages) - reached if p.parent.name in ("docs", "maps")}
    assert missing == set()


def given_commands(text):
    """Yield command lines in code: whole lines of code blocks, and inline code."""
    blocks = "\n".join(re.findall(r"^```[^\n]*\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))
    blocks = re.sub(r"\\\n\s*", " ", blocks)
    yield from (match.strip() for match in re.findall(r"^(?:\$ )?(expmap .+)$", blocks, flags=re.MULTILINE))
    outside = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    yield from (re.sub(r"\s+", " ", found) for found in re.findall(r"`(expmap [^`]+)`", outside))


def problem(line):
    """Return why a command line is invalid; None if it is valid. Files need not exist."""
    words = shlex.split(line.split("  #")[0])[1:]
    command, context = root, click.Context(root, info_name="expmap")
    while isinstance(command, click.Group):
        if not words:
            return None
        found = command.get_command(context, words[0])
        if found is None:
            return f"no command {words[0]}"
        command, words = found, words[1:]
        context = click.Context(command, **root.context_settings)  # click caches the help option
    if not words or any(word.startswith(("[", "{")) for word in words):  # a usage line
        return None
    try:
        values, rest, _ = command.make_parser(context).parse_args(words)
        for option in command.params:
            given = values.get(option.name)
            if isinstance(option.type, click.Choice | click.IntRange | click.FloatRange) and isinstance(
                given, str
            ):
                option.type_cast_value(context, given)
    except click.ClickException as error:
        return error.format_message()
    return f"too much: {rest}" if rest else None


def test_commands_in_the_documentation_can_be_given(pages):
    result = [(path.name, line) for path, text in pages.items() for line in given_commands(text)]
    assert len(result) > 20
    broken = [f"{name}: {line}: {why}" for name, line in result if (why := problem(line))]
    assert broken == []


@pytest.mark.parametrize(
    "line",
    ["expmap bogus", "expmap build m.cfg --bogus", "expmap build m.cfg --method best", "expmap build a b"],
)
def test_wrong_commands_are_noticed(line):
    assert problem(line)


def test_targets_of_make_in_the_documentation_exist(pages, project):
    targets = set(re.findall(r"^([a-z-]+):", (project / "Makefile").read_text("utf-8"), flags=re.MULTILINE))
    named = {
        name
        for text in pages.values()
        for name in re.findall(r"(?:`|^)make ([a-z-]+)", text, flags=re.MULTILINE)
    }
    assert named and named <= targets
