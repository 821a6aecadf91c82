"""A missing package is an error with the command that installs it."""

import pytest

from tests.standin_models import brightest
from webapp.core.features.keypoint_networks import DiskNetwork
from webapp.core.features.table import choose
from webapp.errors import MissingPart
from webapp.extras import EXTRAS, extra, install_line, is_installed
from webapp.files.localize.models import is_usable, usable_features


@pytest.mark.parametrize("name", EXTRAS)
def test_a_missing_extra_names_the_command_that_installs_it(absent, name):
    assert is_installed(name)
    absent(name)
    assert not is_installed(name)
    with pytest.raises(MissingPart) as missing, extra(name):
        __import__(EXTRAS[name][-1])
    assert missing.value.hint == install_line(name) == f"pip install 'experience-map[{name}]'"


def test_another_package_that_is_missing_is_no_missing_extra():
    with pytest.raises(ModuleNotFoundError), extra("learned"):
        import no_such_package  # noqa: F401


def test_networks_need_onnxruntime(absent, tmp_path):
    (tmp_path / "disk.onnx").write_bytes(brightest("disk"))
    choice = choose("verified", features="disk")
    assert is_usable(choice, tmp_path, method="verified")
    absent("learned")
    with pytest.raises(MissingPart, match=r"experience-map\[learned\]"):
        DiskNetwork(brightest("disk"), "disk.onnx")
    assert not is_usable(choice, tmp_path, method="verified")
    assert "sift" in usable_features(tmp_path)
    assert "disk" not in usable_features(tmp_path)
