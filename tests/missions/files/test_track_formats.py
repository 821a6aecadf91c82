"""The entry of each format of tracks is the only place that describes it."""

import re

import pytest
from click.testing import CliRunner

from tests.design.conftest import ROOT
from webapp.extras import EXTRAS
from webapp.missions.cli.mission import import_files
from webapp.missions.files.track_reader import FORMATS, accepted, called


def row(entry):
    """Return the line of a format in the documentation."""
    about, endings = entry.about, " ".join(f"`{ending}`" for ending in entry.endings)
    cells = (entry.title, endings, about.tracks, about.objects, about.left_out, about.written_by)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def test_the_documentation_has_the_line_of_every_format():
    text = (ROOT / "docs" / "track-files.md").read_text("utf-8").partition("## Formats")[2]
    table = re.search(r"(?:^\|.*\n)+", text, flags=re.MULTILINE)[0].splitlines()
    assert table[2:] == [row(entry) for entry in FORMATS.values()]


def test_the_command_names_every_format():
    said = " ".join(CliRunner().invoke(import_files, ["--help"]).output.split())
    assert [name for name in called(FORMATS.values()) if name not in said] == []


@pytest.mark.parametrize("entry", FORMATS.values(), ids=FORMATS)
def test_an_entry_is_complete(entry):
    assert entry.needs in ("", *EXTRAS)
    assert set(entry.endings) <= set(accepted().split(","))
    assert entry.about.tracks
    assert entry.about.written_by
