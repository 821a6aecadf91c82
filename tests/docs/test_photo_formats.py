"""The table of formats in `docs/photos.md` has those that are read."""

import io
import re
from pathlib import Path

import piexif
import pillow_heif
import pytest
from PIL import Image

from webapp.files.decode import FORMATS, IMAGE_FORMATS
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits

TEXT = (Path(__file__).parents[2] / "docs" / "photos.md").read_text("utf-8")
ROWS = {
    row[0]: row for row in re.findall(r"^\| ([A-Z0-9]+) \| (`\.[^|]*) \| ([^|]*) \| ([^|]*) \|", TEXT, re.M)
}


def test_the_table_has_each_format_that_is_read():
    assert tuple(ROWS) == FORMATS
    listed = {name: set(re.findall(r"`(\.\w+)`", row[1])) for name, row in ROWS.items()}
    assert listed == {name: set(entry.suffixes) for name, entry in IMAGE_FORMATS.items()}


@pytest.mark.parametrize("name", FORMATS)
def test_metadata_are_read_from_the_formats_of_which_the_table_says_so(name):
    pillow_heif.register_heif_opener()
    at = {1: b"N", 2: ((10, 1), (0, 1), (0, 1)), 3: b"E", 4: ((20, 1), (0, 1), (0, 1))}
    file, options = io.BytesIO(), {}
    if "EXIF," in ROWS[name][3] and name != "JPEG2000":
        options["exif"] = piexif.dump({"GPS": at})
    Image.new("RGB", (40, 30)).save(file, name, **options)
    facts = read_facts(file.getvalue(), limits=PhotoLimits())
    assert facts.format == name
    assert bool(facts.gps) is bool(options)
