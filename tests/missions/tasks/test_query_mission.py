"""Queries are answered correctly, and expose nothing else."""

import csv
import io
import json
import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from webapp.errors import UsageError
from webapp.missions.store import query
from webapp.missions.store.query import Question, parse_question
from webapp.missions.tasks.export import query_mission


@pytest.fixture
def ask(library):
    """Query a mission, and return the parsed answer."""

    def ask(mission, table="objects", form="json", **question):
        pieces = query_mission(library, mission, question=Question(table, **question), form=form).pieces
        text = b"".join(pieces).decode()
        return json.loads(text) if form == "json" else list(csv.reader(io.StringIO(text)))

    return ask


@pytest.mark.parametrize(
    ("where", "ids"),
    [
        ("", "0123456"),
        ("class = 'car'", "135"),
        ("class != 'car' and confidence > 0.2", "46"),
        ("not (class = 'car' or confidence <= 0.2)", "46"),
        ("id in ('o1', 'o5', 'none')", "15"),
        ("id not in ('o1', 'o5')", "02346"),
        ("confidence between 0.1 and 0.3", "123"),
        ("class like 'VIC%'", "0246"),
        ("class like '%_r'", "135"),
        ("class like '\\'", ""),
        ("height_m is null", "0123456"),
        ("height_m is not null", ""),
        ("last_time >= '2026-05-01T10:05:00Z'", "56"),
        ("first_time = 1777629600", "0123456"),
        ("sightings = 2 and lat < 50.0015", "01"),
    ],
)
def test_conditions_choose_rows(ask, new_mission, where, ids):
    answer = ask(new_mission(objects=7), select="id", where=where, order="id")
    assert answer == {"columns": ["id"], "rows": [[f"o{id}"] for id in ids], "complete": True}


def test_orders_limits_and_columns(ask, new_mission):
    mission = new_mission(objects=5)
    answer = ask(mission, select="class, confidence", order="class desc, confidence desc", limit=3)
    assert answer["rows"] == [["victim", 0.4], ["victim", 0.2], ["victim", 0.0]]
    assert answer["complete"] is False
    assert ask(mission, limit=5)["complete"] is True
    assert ask(mission, limit=0) == {"columns": ask(mission)["columns"], "rows": [], "complete": False}


def test_poses_and_sightings_can_be_asked_for(ask, new_mission):
    mission = new_mission(100)
    poses = ask(mission, "poses", select="source,number,time", where="number >= 98")
    assert poses["rows"] == [["gps", 98, 1777629649.0], ["gps", 99, 1777629649.5]]
    seen = ask(mission, "sightings", select="id,class,number", where="class = 'car'")
    assert seen["rows"] == [["o1", "car", 0], ["o1", "car", 1]]


def test_csv_has_a_header(ask, new_mission):
    rows = ask(new_mission(), form="csv", select="id,height_m", order="id", limit=2)
    assert rows == [["id", "height_m"], ["o0", ""], ["o1", ""]]


def test_another_mission_stays_closed(ask, new_mission):
    mine, other = new_mission(3), new_mission(4, objects=9)
    for table, count in (("poses", 3), ("objects", 3), ("sightings", 6)):
        for where in ("", "lat > -90 or lat <= -90", "not (lat is null)"):
            assert len(ask(mine, table, where=where)["rows"]) == count
    assert len(ask(other)["rows"]) == 9


@pytest.mark.parametrize(
    ("wish", "where"),
    [
        ({"where": "lat >"}, "where, character 6"),
        ({"select": "id, token_hash"}, "select, character 5"),
        ({"order": "1"}, "order, character 1"),
        ({"limit": -1}, "limit"),
        ({"limit": 10**9}, "limit"),
        ({"table": "account"}, "from"),
    ],
)
def test_errors_are_reported_with_their_position(ask, new_mission, wish, where):
    with pytest.raises(UsageError) as caught:
        ask(new_mission(), **wish)
    assert caught.value.where == where


def test_what_takes_too_long_is_stopped(ask, new_mission, monkeypatch):
    mission = new_mission(20_000)
    monkeypatch.setattr(query, "MAX_SECONDS", 0.0)
    with pytest.raises(UsageError, match="more than 0 seconds"):
        ask(mission, "poses", select="number", order="lat", limit=1)
    monkeypatch.setattr(query, "MAX_SECONDS", 5.0)
    assert len(ask(mission, "poses", limit=20_000)["rows"]) == 20_000


def test_a_client_that_reads_slowly_holds_nothing(library, new_mission):
    mission = new_mission(3000)
    pieces = query_mission(library, mission, question=Question("poses", limit=3000), form="json").pieces
    next(pieces)
    assert library.database.engine.pool.checkedout() == 0
    pieces.close()


values = st.one_of(
    st.text(max_size=20).map(lambda text: "'" + text.replace("'", "''") + "'"),
    st.sampled_from(["'x'' OR 1=1 --'", "'%'", "1e308", "-1", "99999999999999999999", "'\\'"]),
)
conditions = st.recursive(
    st.one_of(
        st.tuples(
            st.sampled_from(["id =", "class !=", "photo <", "class like", "lat >", "sightings ="]), values
        ).map(" ".join),
        st.sampled_from(["id is null", "lat between 1 and 60", "id in ('o1', 'it''s')"]),
    ),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(" ".join),
        inner.map("not ({})".format),
        inner.map("({})".format),
    ),
    max_leaves=6,
)
HOSTILE = [
    "; DROP TABLE mission",
    "' OR '1'='1",
    "id = id",
    "UNION SELECT name FROM account",
    "/**/",
    "x'41'",
]


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(where=st.one_of(conditions, st.text(max_size=40), st.sampled_from(HOSTILE)), select=st.just("id"))
def test_no_text_gets_more_than_the_rows_of_its_mission(made, ask, where, select):
    mission, statements = made
    statements.clear()
    try:
        answer = ask(mission, select=select, where=where)
    except UsageError:
        return
    assert {row[0] for row in answer["rows"]} <= {"o0", "o1", "o2"}
    (statement,) = [sql for sql in statements if "SELECT" in sql]
    for quote in ("'", '"', ";", "--", "/*"):
        assert quote not in statement.replace("ESCAPE '\\'", "")


@pytest.fixture
def made(library, new_mission):
    """A mission next to another one, and the executed statements without their values."""
    from sqlalchemy import event

    mission = new_mission()
    new_mission(objects=9)
    statements = []
    event.listen(
        library.database.engine,
        "before_cursor_execute",
        lambda _c, _cursor, statement, *_rest: statements.append(statement),
    )
    return mission, statements


def test_the_docs_name_all_columns(ask, new_mission):
    page = Path(__file__).resolve().parents[3] / "docs" / "mission-exports.md"
    mission = new_mission()
    for table in query.TABLES:
        (row,) = re.findall(rf"^\| `{table}` \| `([^`]*)` \|$", page.read_text("utf-8"), re.MULTILINE)
        assert row.split() == ask(mission, table)["columns"]


def test_values_are_bound(new_mission):
    asked = parse_question(new_mission(), Question("objects", where="id = 'o1'' OR 1=1 --'"))
    compiled = asked.rows.compile()
    assert "o1" not in str(compiled)
    assert "o1' OR 1=1 --" in compiled.params.values()
