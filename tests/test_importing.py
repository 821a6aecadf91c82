"""Objects are imported by name, without garbage collection meanwhile."""

import gc
import sys

import pytest

from webapp.importing import import_name

NOTICES = "import gc\nCOLLECTED = gc.isenabled()\n"


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "notices_garbage.py").write_text(NOTICES)
    monkeypatch.syspath_prepend(tmp_path)
    yield "notices_garbage"
    sys.modules.pop("notices_garbage", None)


def test_garbage_is_searched_after_the_import_only(module):
    assert import_name(f"{module}:COLLECTED") is False
    assert gc.isenabled()


def test_garbage_is_searched_after_an_import_that_fails(module):
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        import_name(f"{module}:absent")
    assert gc.isenabled()


def test_a_process_that_does_not_search_for_garbage_goes_on_so(module):
    gc.disable()
    try:
        import_name(f"{module}:COLLECTED")
        assert not gc.isenabled()
    finally:
        gc.enable()
