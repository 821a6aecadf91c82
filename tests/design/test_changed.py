"""The selection of tests by what has changed."""

from tests.changed import selected


def test_a_module_selects_its_own_tests_and_those_of_what_imports_it():
    found = selected(["webapp/files/maps/cfg.py"])
    assert "tests/files/maps/test_cfg.py" in found
    assert "tests/tasks/maps/test_export.py" in found or any(
        name.startswith("tests/tasks/") for name in found
    )
    assert "tests/missions/files/readers/test_xml_tracks.py" not in found


def test_a_test_selects_itself_and_a_text_nothing():
    assert selected(["tests/core/geo/test_local_metres.py"]) == ["tests/core/geo/test_local_metres.py"]
    assert selected(["README.md"]) == []


def test_what_only_the_composition_imports_does_not_select_everything():
    assert len(selected(["webapp/web/sharing/pages.py"])) < 60
