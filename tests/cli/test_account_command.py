"""`expmap account`."""

import re

import pytest

from webapp.store.accounts import accounts, sign_in
from webapp.store.library import open_library


@pytest.fixture
def library(tmp_path, monkeypatch):
    """The library of the commands."""
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


def test_a_link_signs_the_owner_in(expmap, library):
    code, out, _ = expmap("account", "link", "--url", "https://maps.example/")
    assert code == 0
    token = re.fullmatch(r"https://maps\.example/sign-in/(\S+)\n", out)[1]
    with library.database.read() as session:
        assert sign_in.link_account(session, token).is_owner


def test_a_token_is_all_that_is_printed(expmap, library):
    token = expmap("account", "token", "--name", "robot")[1].strip()
    with library.database.read() as session:
        account, known = accounts.by_token(session, token)
    assert (account.is_owner, known.name) == (True, "robot")


def test_a_token_of_the_same_name_is_made_only_in_place_of_the_other(expmap, library):
    first = expmap("account", "token", "--name", "robot")[1].strip()
    code, _, result = expmap("account", "token", "--name", "robot")
    assert code == 1
    assert "already" in result
    second = expmap("account", "token", "--name", "robot", "--replace")[1].strip()
    with library.database.read() as session:
        assert accounts.by_token(session, first) is None
        assert accounts.by_token(session, second) is not None


def test_accounts_are_added_and_listed(expmap, library):
    expmap("account", "token", "--name", "robot")
    link = expmap("account", "add", "Jana")[1].strip()
    with library.database.read() as session:
        assert sign_in.link_account(session, link.rsplit("/", 1)[1]).name == "Jana"
    lines = [line.split("\t")[:2] for line in expmap("account", "list")[1].splitlines()]
    assert lines == [["Jana", "-"], ["owner", "owner"]]
    assert expmap("account", "link", "--account", "Petr")[0] == 1


def test_a_library_can_begin_with_a_token(expmap, tmp_path):
    """For example, when a script sets up a server before it is started."""
    token = expmap("account", "token", "--name", "robot", "--library", tmp_path / "new")[1].strip()
    library = open_library(tmp_path / "new")
    with library.database.read() as session:
        assert accounts.by_token(session, token)[0].is_owner
    library.database.close()
