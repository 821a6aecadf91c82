"""Every command, option, setting and error is documented, and nothing else is."""

import re

import pytest

from docs import make_commands, make_settings
from webapp import errors
from webapp.cli.exitcodes import exit_code
from webapp.configuration import CONFIG, settings_table
from webapp.core.features.table import BUNDLES, EXTRACTORS
from webapp.web.localize.api_localize import QuestionIn


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


@pytest.fixture(scope="module")
def chapters(project):
    """The sections of the page about the commands."""
    return sections((project / "docs" / "commands.md").read_text("utf-8"))


def test_every_command_has_a_section_and_no_other_has(commands, chapters):
    assert [name.strip("`") for name in chapters if name.startswith("`expmap")] == list(commands)


def test_options_are_listed_as_the_program_has_them(project):
    text = (project / "docs" / "commands.md").read_text("utf-8")
    assert make_commands.page(text) == text, "run docs/make_commands.py"


def test_every_section_says_what_its_command_does(commands, chapters):
    for words in commands:
        lines = re.sub(r"^```.*?^```", "", chapters[f"`{words}`"], flags=re.M | re.S).split("\n")
        assert any(re.match(r"[A-Z[]", line) and not line.startswith("Also [") for line in lines), words


def test_changed_options_are_brought_up_to_date_and_texts_by_hand_stay(project):
    text = (project / "docs" / "commands.md").read_text("utf-8")
    seed = "- `--seed N`: Random seed of the synthetic park. (default: 7)\n"
    assert seed in text and "\n## `expmap settings`\n" in text
    stale = text.replace(seed, "- `--old`: An option that is gone.\n")
    stale = stale.replace(
        "\n## `expmap settings`\n",
        "\n## `expmap gone`\n\n```\nexpmap gone\n```\n\nLong ago.\n\n## `expmap settings`\n",
    )
    assert make_commands.page(stale) == text
    by_hand = text.replace("Makes a small map", "Makes a map")
    assert make_commands.page(by_hand) == by_hand


def test_all_features_and_their_models_are_explained(project):
    documented = {
        row[0].strip("`") for row in rows((project / "docs" / "features.md").read_text("utf-8"), "name")
    }
    models = [m for entry in EXTRACTORS.values() for m in (entry.model, entry.pair_matcher) if m is not None]
    supplied = {model.files[0].name for model in models if not model.files[0].published}
    assert documented == {*BUNDLES} | supplied


def test_settings_are_listed_as_the_program_has_them(project):
    text = (project / "docs" / "settings.md").read_text("utf-8")
    assert make_settings.page(text) == text, "run docs/make_settings.py"
    photo = "- `photo.max_mb` (64): File size, MB.\n"
    assert photo in text
    assert make_settings.page(text.replace(photo, "- `photo.gone`: Gone.\n")) == text


def test_every_setting_says_what_it_is_for():
    said = make_settings.descriptions()
    assert [key for key in settings_table() if not said.get(key, "").endswith(".")] == []


def test_every_environment_variable_follows_from_its_setting_or_is_named(project):
    text = (project / "docs" / "settings.md").read_text("utf-8")
    variables = [setting.variables for setting in settings_table().values()]
    keys = list(settings_table())
    assert [first for first, *_ in variables] == [f"EXPMAP_{k.upper().replace('.', '_')}" for k in keys]
    named = set(re.findall(r"`(EXPMAP_[A-Z_]+)`", text))
    assert named == {name for _, *others in variables for name in others} | {CONFIG, "EXPMAP_WEB_PROXIES"}


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
