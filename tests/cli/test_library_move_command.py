"""`expmap library move`: one line of output, an exit code, and a hint on the next step."""

import pytest

from webapp.store.library import open_library


@pytest.fixture
def folder(tmp_path, library_folder):
    open_library(tmp_path).database.close()
    return tmp_path


@pytest.fixture
def url(postgresql):
    made = postgresql.new_database(empty=True)
    yield made
    postgresql.drop(made)


def test_it_moves_there_and_back(folder, url, expmap, monkeypatch):
    monkeypatch.setenv("EXPMAP_DATABASE", url)
    code, out, err = expmap("library", "move", "--to", "postgresql", "--library", folder)
    assert code == 0
    assert "tables, 0 rows, now in postgresql+psycopg://" in out
    assert "before the next start: set EXPMAP_DATABASE" in err
    code, out, err = expmap("library", "move", "--to", "sqlite", "--library", folder)
    assert code == 0
    assert out.endswith("library.db\n")
    assert "before the next start: unset EXPMAP_DATABASE" in err


def test_an_address_may_be_given(folder, url, expmap):
    assert expmap("library", "move", "--to", url, "--library", folder)[0] == 0


@pytest.mark.parametrize(
    ("to", "code", "words"),
    [
        ("sqlite", 2, "are in SQLite already"),
        ("postgresql", 2, "EXPMAP_DATABASE: the address of the database is needed"),
        ("mysql://host/database", 2, "not a supported database"),
        ("postgresql+psycopg://a@127.0.0.1:1/b", 1, "cannot be reached"),
    ],
)
def test_what_does_not_work_is_said_in_a_line(folder, expmap, to, code, words):
    ended, _, err = expmap("library", "move", "--to", to, "--library", folder)
    assert ended == code
    assert words in err.strip().splitlines()[-1]


def test_a_place_that_is_none_is_refused_at_once(expmap, tmp_path):
    code, out, err = expmap("library", "move", "--to", "mysql", "--library", tmp_path)
    assert (code, out) == (2, "")
    assert err.startswith("expmap: --to: cannot move to 'mysql' (write sqlite, postgresql, s3, folder")
