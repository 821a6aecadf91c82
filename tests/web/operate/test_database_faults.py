"""A database that is cut off, read-only or too slow: a clear error, no partial changes, and recovery."""

import pytest
from sqlalchemy import make_url, text

from tests.tcp_proxy import TcpProxy
from webapp.app.web import create_app
from webapp.store.library import open_library
from webapp.store.maps import maps

pytestmark = pytest.mark.usefixtures("postgresql_only")


@pytest.fixture
def network(database_url):
    """The proxy between this machine and the server."""
    proxy = TcpProxy(f"{make_url(database_url).query['host']}/.s.PGSQL.5432")
    yield proxy
    proxy.close()


@pytest.fixture
def app(settings, library, database_url, network, app):
    """The application across the network, with a timeout of a second for statements."""
    host, port = network.address
    url = make_url(database_url).set(host=host, port=port, query={"options": "-cstatement_timeout=1s"})
    far = open_library(library.folder, url=url.render_as_string(hide_password=False))
    made = create_app(settings, library=far)
    made.testing = True
    made.test_client_class = app.test_client_class
    yield made
    far.database.close()


def refused(answer, sentence):
    """Check that a response is an error in the usual form with a time to retry."""
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "2")
    error = answer.get_json()["error"]
    assert (error["code"], error["message"]) == ("database_unavailable", sentence)
    assert "expmap@" not in answer.text, "the address of the database is nobody's business"
    return True


def slugs(client):
    return sorted(one["slug"] for one in client.get("/api/v1/maps").get_json()["maps"])


def test_cut_during_a_request(client, network, monkeypatch):
    real = maps.create

    def cut(session, *arguments, **named):
        made = real(session, *arguments, **named)
        session.flush()
        network.cut()
        return made

    with monkeypatch.context() as context:
        context.setattr(maps, "create", cut)
        answer = client.post("/api/v1/maps", json={"name": "Park"})
        assert refused(answer, "the database server cannot be reached")
    assert refused(client.get("/api/v1/maps"), "the database server cannot be reached")
    page = client.get("/")
    assert page.status_code == 503 and "The database server cannot be reached" in page.text
    network.mend()
    assert slugs(client) == []
    assert client.post("/api/v1/maps", json={"name": "Park"}).status_code == 201
    assert slugs(client) == ["park"]


def set_default(library, change):
    """Change a setting of the database for all connections, which are reopened."""
    others = "FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
    with library.database.engine.connect() as connection:
        connection.exec_driver_sql("SET TRANSACTION READ WRITE")
        name = connection.exec_driver_sql("SELECT current_database()").scalar_one()
        connection.exec_driver_sql(f"ALTER DATABASE {name} {change}")
        connection.commit()
        connection.exec_driver_sql(f"SELECT pg_terminate_backend(pid) {others}")
        connection.invalidate()


def test_read_only(client, library, park):
    """As with a standby, or a server set read-only because its disk is full."""
    set_default(library, "SET default_transaction_read_only = on")
    for answer in (
        client.post("/api/v1/maps", json={"name": "Yard"}),
        client.patch(f"/api/v1/maps/{park}", json={"name": "Yard"}),
    ):
        assert refused(answer, "the database is read-only")
    assert client.get("/").status_code == 200
    assert slugs(client) == [park]
    set_default(library, "RESET default_transaction_read_only")
    assert client.patch(f"/api/v1/maps/{park}", json={"name": "Yard"}).get_json()["name"] == "Yard"


def test_others_hold_what_a_request_needs_for_too_long(client, library, park):
    with library.database.write() as session:  # excludes all other writers
        session.execute(text("SELECT 1"))
        answer = client.post("/api/v1/maps", json={"name": "Yard"})
        assert refused(answer, "the database took too long, and was stopped")
        assert slugs(client) == ["park"]
    assert client.post("/api/v1/maps", json={"name": "Yard"}).status_code == 201
