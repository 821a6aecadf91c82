"""Settings from the environment and from a file, and invalid ones."""

from pathlib import Path

import pytest

from webapp.configuration import (
    CONFIG,
    effective_settings,
    load_settings,
    rename_old_variables,
    settings_table,
)
from webapp.errors import UsageError
from webapp.settings import Settings

ALL = settings_table().values()


@pytest.fixture
def file(tmp_path):
    """Write a settings file, and return the environment that names it."""

    def write(text):
        (tmp_path / "expmap.toml").write_text(text)
        return {CONFIG: str(tmp_path / "expmap.toml")}

    return write


def other(setting):
    """Return a value that is not the default, as text and parsed."""
    if setting.kind in (int, float):
        return str(setting.default * 2 + 1), setting.default * 2 + 1
    if setting.choices is not None:
        return setting.choices.values[-1], setting.choices.values[-1]
    return "/else", setting.kind("/else")


def value(settings, key):
    for part in key.split("."):
        settings = getattr(settings, part)
    return settings


def test_nothing_is_set():
    assert load_settings({}) == Settings()
    assert load_settings({name: "" for setting in ALL for name in setting.variables}) == Settings()


@pytest.mark.parametrize("setting", ALL, ids=lambda s: s.key)
def test_each_setting_has_a_variable_and_a_place_in_the_file(setting, file):
    text, kept = other(setting)
    for variable in setting.variables:
        assert value(load_settings({variable: text}), setting.key) == kept
    section, _, name = setting.key.rpartition(".")
    written = f'"{text}"' if setting.kind in (str, Path) else text
    env = file((f"[{section}]\n" if section else "") + f"{name} = {written}\n")
    assert value(load_settings(env), setting.key) == kept
    (found,) = [one for one in effective_settings(env) if one.source != "default"]
    assert (found.setting.key, found.value, found.source) == (setting.key, kept, env[CONFIG])


def test_a_variable_goes_before_the_file_and_the_longer_name_before_the_short_one(file):
    env = file("[web]\nproxies = 1\n")
    assert load_settings(env | {"EXPMAP_PROXIES": "2"}).web.proxies == 2
    assert load_settings(env | {"EXPMAP_PROXIES": "2", "EXPMAP_WEB_PROXIES": "3"}).web.proxies == 3
    assert load_settings(env | {"EXPMAP_PROXIES": ""}).web.proxies == 1


def test_deprecated_variables_count_as_before_and_are_named_once():
    env = {"EXPMAP_PROXIES": "2", "EXPMAP_TILES": "mine.json", "EXPMAP_MEMORY_MB": "", "HOME": "/root"}
    before = load_settings(env)
    said = rename_old_variables(env)
    assert env == {"EXPMAP_WEB_PROXIES": "2", "EXPMAP_TILE_SERVICES": "mine.json", "HOME": "/root"}
    assert [one.split()[0] for one in said] == ["EXPMAP_TILES", "EXPMAP_PROXIES"]
    assert "set EXPMAP_WEB_PROXIES instead" in said[1]
    assert load_settings(env) == before
    assert rename_old_variables(env) == []
    env |= {"EXPMAP_PROXIES": "3"}
    assert len(rename_old_variables(env)) == 1 and env["EXPMAP_WEB_PROXIES"] == "2"


def test_paths_in_the_file_are_relative_to_its_folder(file, tmp_path):
    assert load_settings(file('library = "all maps"')).library == tmp_path / "all maps"


def test_whole_numbers_are_numbers(file):
    assert load_settings(file("[photo]\nmax_mb = 10")).photo.max_mb == 10.0


@pytest.mark.parametrize("text", ["yes", "-1", "1.5", "²", "1e400", "nan"])
def test_a_number_of_proxies_that_is_none(text):
    with pytest.raises(UsageError, match="is not allowed") as rejected:
        load_settings({"EXPMAP_WEB_PROXIES": text})
    assert rejected.value.where == "EXPMAP_WEB_PROXIES"
    assert "a whole number of at least 0" in rejected.value.hint


@pytest.mark.parametrize("text", ["much", "-1", "inf", "nan", "500 MB", "²"])
def test_megabytes_that_are_none(text):
    with pytest.raises(UsageError, match="is not allowed") as rejected:
        load_settings({"EXPMAP_RETRIEVAL_MEMORY_MB": text})
    assert rejected.value.where == "EXPMAP_RETRIEVAL_MEMORY_MB"


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        ("[extract]\nmax_side = 900", ": extract.max_side", "max_side_px, keypoints"),
        ("[extrct]\nkeypoints = 900", ": extrct", "[extract]"),
        ("extract = 900", ": extract", "write [extract]"),
        ("[extract.more]\na = 1", ": extract.more", "max_side_px, keypoints"),
        (
            '[extract]\nkeypoints = "900"',
            ": extract.keypoints",
            "at least 16, for example 1000",
        ),
        ("[extract]\nkeypoints = 900.0", ": extract.keypoints", "a whole number"),
        ("[extract]\nkeypoints = true", ": extract.keypoints", "a whole number"),
        ("[extract]\nkeypoints = 3", ": extract.keypoints", "of at least 16"),
        ("[photo]\nmax_mb = 0", ": photo.max_mb", "a number above 0"),
        ("[photo]\nmax_mb = [1]", ": photo.max_mb", "a number above 0"),
        ("library = 5", ": library", "a path"),
        ('token = ""', ": token", "a string"),
        ("[extract\n", "", "at line 1"),
    ],
)
def test_what_is_wrong_in_a_file_is_named_with_what_is_allowed(file, text, where, said):
    env = file(text)
    with pytest.raises(UsageError) as rejected:
        load_settings(env)
    assert rejected.value.where == env[CONFIG] + where
    assert said in str(rejected.value)


def test_a_variable_that_is_spelled_like_a_setting_and_is_none():
    with pytest.raises(UsageError, match="unknown setting") as rejected:
        load_settings({"EXPMAP_EXTRACT_MAX_SIDE": "900"})
    assert rejected.value.where == "EXPMAP_EXTRACT_MAX_SIDE"
    assert "max_side_px" in rejected.value.hint
    assert load_settings({"EXPMAP_OTHER": "1"}) == Settings()


def test_a_file_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(UsageError, match="cannot be read"):
            load_settings({CONFIG: str(path)})
    (tmp_path / "latin.toml").write_bytes(b'library = "\xe9"')
    with pytest.raises(UsageError, match="not a TOML file"):
        load_settings({CONFIG: str(tmp_path / "latin.toml")})
