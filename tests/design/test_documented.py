"""Every command, option, setting and error is documented, and nothing else is."""

import re

import click
import pytest

from webapp import errors
from webapp.cli import options
from webapp.cli.exitcodes import exit_code
from webapp.configuration import CONFIG, settings_table
from webapp.core.features.table import BUNDLES, EXTRACTORS
from webapp.web.localize.api_localize import QuestionIn

SHARED = "Options that `build`, `localize` and `evaluate` share"


def sections(text):
    """Return the text below each second-level heading."""
    parts = re.split(r"^## (.+)$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rows(text, head):
    """Return the cells of the tables with this header in the first column."""
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        lines = [re.split(r"(?<!\\)\|", line.strip().strip("|")) for line in block.splitlines()]
        if lines[0][0].strip() == head:
            found += [[cell.strip().replace("\\|", "|") for cell in line] for line in lines[2:]]
    return found


def spelled(option, command):
    """Return an option as in the documentation: all names, and the placeholder after the last."""
    *others, last = sorted(option.opts, key=len)
    value = "" if option.is_flag else option.make_metavar(click.Context(command))
    if isinstance(option.type, click.Choice):
        value = "|".join(option.type.choices)
    return ", ".join(f"`{name}`" for name in (*others, f"{last} {value}".strip()))


@pytest.fixture(scope="module")
def chapters(project):
    """The sections of the page about the commands."""
    return sections((project / "docs" / "commands.md").read_text("utf-8"))


@pytest.fixture(scope="module")
def shared():
    """The names of the options shared by several commands."""
    decorated = options.index_options(options.map_options(lambda: None))
    return {param.name for param in decorated.__click_params__}


def test_every_command_has_a_section_and_no_other_has(commands, chapters):
    assert [name.strip("`") for name in chapters if name.startswith("`expmap")] == list(commands)


def test_every_option_is_explained_as_it_is_spelled(commands, chapters, shared):
    for words, command in commands.items():
        own = [p for p in command.params if isinstance(p, click.Option) and p.name not in shared]
        documented = {row[0] for row in rows(chapters[f"`{words}`"], "option")}
        assert documented == {spelled(option, command) for option in own}, words
        if any(param.name in shared for param in command.params):
            assert SHARED[0].lower() + SHARED[1:] in chapters[f"`{words}`"], words


def test_shared_options_are_explained_once(commands, chapters, shared):
    documented = {row[0] for row in rows(chapters[SHARED], "option")}
    for words in ("expmap build", "expmap localize", "expmap evaluate"):
        command = commands[words]
        assert documented == {spelled(p, command) for p in command.params if p.name in shared}


def test_usage_names_every_argument(commands, chapters):
    for words, command in commands.items():
        # The command caches the names of its help option, and other tests call it, too.
        context = click.Context(command, help_option_names=["-h", "--help"])
        usage = " ".join(command.collect_usage_pieces(context))
        assert f"{words} {usage}" in chapters[f"`{words}`"], words


def test_defaults_are_reported(commands, chapters):
    for words, command in commands.items():
        table = {row[0]: row[1] for row in rows(chapters[f"`{words}`"] + chapters[SHARED], "option")}
        for option in command.params:
            if isinstance(option, click.Option) and option.show_default is True:
                assert f"(default: {option.default})" in table[spelled(option, command)], option.opts


def test_all_features_and_their_models_are_explained(project):
    documented = {
        row[0].strip("`") for row in rows((project / "docs" / "features.md").read_text("utf-8"), "name")
    }
    models = [m for entry in EXTRACTORS.values() for m in (entry.model, entry.pair_matcher) if m is not None]
    supplied = {model.files[0].name for model in models if not model.files[0].published}
    assert documented == {*BUNDLES} | supplied


def test_every_setting_is_explained_with_its_variable(project):
    documented = rows((project / "docs" / "settings.md").read_text("utf-8"), "setting")
    result = {row[0].strip("`"): (row[1].strip("`"), row[2].strip("`")) for row in documented}
    table = settings_table().values()
    assert result == {s.key: (s.variables[0], "none" if s.default is None else str(s.default)) for s in table}


def test_every_environment_variable_is_explained(project):
    text = (project / "docs" / "settings.md").read_text("utf-8")
    known = {name for setting in settings_table().values() for name in setting.variables}
    assert set(re.findall(r"`(EXPMAP_[A-Z_]+)`", text)) == known | {CONFIG}


def test_every_error_is_explained_with_its_exit_code(project):
    documented = {
        row[0].strip("`"): row[1]
        for row in rows((project / "docs" / "errors.md").read_text("utf-8"), "error")
    }
    kinds = {
        name: kind
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and issubclass(kind, errors.ExpMapError) and kind is not errors.ExpMapError
    }
    assert documented == {name: str(exit_code(kind.__new__(kind))) for name, kind in kinds.items()}
    assert set(re.findall(r"[├└]── (\w+)", errors.__doc__)) == set(kinds), "the tree in errors.py"


def test_every_field_of_a_request_to_localize_is_explained(project):
    text = (project / "docs" / "api.md").read_text("utf-8")
    documented = [name for row in rows(text, "field") for name in re.findall(r"`(\w+)`", row[0])]
    assert documented == [*QuestionIn().fields]
