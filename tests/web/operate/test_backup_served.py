"""A backup made while serving is served elsewhere with the same maps, photos and answers."""

import re
from dataclasses import replace

import pytest

from webapp.app import main as program
from webapp.app.web import create_app
from webapp.store import queries
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.schema import MapRecord, QueryRecord
from webapp.tasks.maps import adopt_map

ANSWER = {"query": "q.jpg", "hypotheses": [{"rank": 1, "x_px": 7.0, "y_px": 8.0, "probability": 0.75}]}


@pytest.fixture
def token(library, owner, make_map):
    """A token for a library with a map and an answer in its history."""
    cfg = make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    photo = (cfg.parent / "photos" / "1.jpg").read_bytes()
    with library.database.write() as session:
        record = session.query(MapRecord).one()
        row = QueryRecord(
            name="q.jpg", file="0.jpg", width=320, height=240, options={}, answer=ANSWER, evidence=[]
        )
        queries.add(session, record, row=row, most=10)
        made = accounts.new_token(session, session.merge(owner), name="test")
    queries.folder(library, record.id).mkdir(parents=True)
    (queries.folder(library, record.id) / "0.jpg").write_bytes(photo)
    return made


def expmap(*words):
    with pytest.raises(SystemExit) as ended:
        program.main([str(word) for word in words])
    return ended.value.code


def answers(app, token):
    """Return the API's data of the map."""
    client = app.test_client()
    client.csrf = False
    queries = ("/queries", "/queries/1/photo")
    paths = ("", *queries, "/findings", "/photos/0/original", "/photos/2/thumb", "/satellite", "/map.cfg")
    got = {}
    for path in paths:
        answer = client.get(f"/api/v1/maps/park{path}", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == 200, path
        got[path] = re.sub(rb"\?v=\w+", b"", answer.data)  # the version for browsers' caches
        answer.close()
    return got


def test_backup_and_restore_by_the_command(app, library, settings, token, tmp_path, capsys):
    before = answers(app, token)
    file, elsewhere = tmp_path / "b.zip", tmp_path / "elsewhere"
    assert expmap("backup", file, "--library", library.folder) == 0
    assert "1 maps, 3 photos" in capsys.readouterr().out
    assert expmap("restore", file, "--library", elsewhere) == 0
    assert "1 maps, 3 photos" in capsys.readouterr().out
    restored = open_library(elsewhere)
    served = create_app(replace(settings, library=elsewhere), library=restored)
    assert answers(served, token) == before
    assert expmap("restore", file, "--library", elsewhere) == 2
    assert "--force" in capsys.readouterr().err
    restored.database.close()


def test_a_lost_file_is_reported_by_the_exit_code(library, token, tmp_path, capsys):
    (library.map_folder("park") / "photos" / "1.jpg").unlink()
    assert expmap("backup", tmp_path / "b.zip", "--library", library.folder) == 1
    assert "maps/park/photos/1.jpg: the library has lost this file" in capsys.readouterr().err


def test_no_library_is_made_where_there_is_none(tmp_path):
    assert expmap("backup", tmp_path / "b.zip", "--library", tmp_path / "typo") == 1
    assert not (tmp_path / "typo").exists()
