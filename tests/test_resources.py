from pathlib import Path

import pytest

from webapp.errors import MissingPart
from webapp.resources import resource_folder


def test_source_tree_has_the_folder_next_to_the_package(tmp_path: Path) -> None:
    (tmp_path / "webapp").mkdir()
    (tmp_path / "templates").mkdir()
    assert resource_folder("templates", package=tmp_path / "webapp") == tmp_path / "templates"


def test_wheel_has_the_folder_inside_the_package_and_that_wins(tmp_path: Path) -> None:
    (tmp_path / "webapp" / "static").mkdir(parents=True)
    (tmp_path / "static").mkdir()
    assert resource_folder("static", package=tmp_path / "webapp") == tmp_path / "webapp" / "static"


def test_missing_folder_is_a_missing_part(tmp_path: Path) -> None:
    with pytest.raises(MissingPart):
        resource_folder("templates", package=tmp_path / "webapp")


def test_templates_are_found_here() -> None:
    assert (resource_folder("templates") / "localize/report.html").is_file()
