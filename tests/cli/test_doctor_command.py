"""`expmap doctor` prints what it found, and its exit code says whether something fails."""

import json

from webapp.store.library import open_library


def test_text_and_json(expmap, tmp_path):
    library = open_library(tmp_path / "library")
    library.database.close()
    code, out, err = expmap("doctor", "--library", library.folder, "--port", 65000)
    assert (code, err) == (0, "")
    assert "ok       database: " in out and "FAILING" not in out
    code, out, _ = expmap("doctor", "--library", library.folder, "--port", 65000, "--json")
    checks = json.loads(out)
    assert code == 0 and {tuple(check) for check in checks} == {("name", "state", "message", "hint")}


def test_what_fails_has_a_hint_and_an_exit_code(expmap, tmp_path):
    library = open_library(tmp_path / "library")
    library.database.close()
    (library.inner / "library.db").write_bytes(b"no database, but of some length" * 1000)
    code, out, _ = expmap("doctor", "--library", library.folder, "--port", 65000)
    assert code == 1 and "FAILING  database: " in out
