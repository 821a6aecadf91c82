"""Counts of `benchmarks.structure` on packages of a few lines."""

import json

import pytest

from benchmarks import structure

SHAPES = '''\
"""Shapes.

More of them.
"""

from pkg.numbers import (
    ONE,
)  # only one


# A comment.
def area(a, b):
    """Compute an area.

    Parameters
    ----------
    a : float
    b : float
        Height, metres.
    """
    text = """
    no docstring
    """
    return a * b * ONE, text  # code
'''


@pytest.fixture
def checkout(tmp_path):
    files = {
        "pkg/__init__.py": '"""A package."""\n',
        "pkg/numbers.py": "ONE = 1\n",
        "pkg/shapes.py": SHAPES,
        "pkg/rooms/first.py": "import pkg.shapes\nfrom pkg import numbers\n",
        "pkg/rooms/second.py": "def late():\n    from pkg.numbers import ONE\n    return ONE\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    return tmp_path


def test_each_line_is_of_one_kind():
    kinds = structure.line_kinds(SHAPES)
    assert kinds == {"docstring": 4 + 8, "import": 3, "comment": 1, "code": 5, "blank": 3}
    assert kinds.total() == len(SHAPES.splitlines())


def test_importers_are_other_modules_of_the_package(checkout):
    found = structure.measure(checkout, package="pkg")
    assert found.one_importer == ["pkg.shapes"]
    assert found.most_alone == ("pkg.rooms.first", 1)
    assert found.no_importer == ["pkg.rooms.first", "pkg.rooms.second"]


def test_relative_imports_count(checkout):
    (checkout / "pkg/rooms/third.py").write_text(
        "from .first import numbers\nfrom . import second\nfrom .. import shapes\n"
    )
    found = structure.measure(checkout, package="pkg")
    assert found.one_importer == ["pkg.rooms.first", "pkg.rooms.second"]
    assert found.no_importer == ["pkg.rooms.third"]


def test_files_and_folders_are_counted(checkout):
    found = structure.measure(checkout, package="pkg")
    assert (found.files, found.median_lines) == (5, 2)
    assert found.folders == [("pkg", 3), ("pkg/rooms", 2)]
    assert found.longest == ("pkg/shapes.py", len(SHAPES.splitlines()))
    assert sum(found.lines.values()) == 1 + 1 + 24 + 2 + 3


def test_a_folder_without_source_is_refused(tmp_path):
    with pytest.raises(SystemExit, match="no Python file"):
        structure.measure(tmp_path, package="pkg")


def test_counts_are_printed_and_written_as_json(checkout):
    found = structure.measure(checkout, package="pkg")
    assert "one importer      1 modules" in structure.as_text(found)
    assert json.loads(json.dumps(structure.as_json(found)))["one_importer"] == ["pkg.shapes"]
