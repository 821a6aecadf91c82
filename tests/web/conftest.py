"""The application on a library in a temporary folder, and browsers that are signed in."""

from uuid import uuid4

import pytest
from flask.testing import FlaskClient
from itsdangerous import URLSafeTimedSerializer

from tests.quick_apps import remember_rules, remember_templates
from webapp.app.web import create_app
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.maps import maps

CSRF = "0" * 40
remember_rules()


class Browser(FlaskClient):
    """A client that sends the CSRF token with all changing requests."""

    csrf = True

    def open(self, *args, **options):
        if self.csrf and options.get("method", "GET") not in ("GET", "HEAD", "OPTIONS"):
            with self.session_transaction() as session:
                session["csrf_token"] = CSRF
            token = URLSafeTimedSerializer(self.application.secret_key, salt="wtf-csrf-token").dumps(CSRF)
            headers = dict(options.pop("headers", None) or {})
            options["headers"] = {"X-CSRFToken": token, **headers}
        return super().open(*args, **options)


@pytest.fixture
def settings(tmp_path, database_url):
    return Settings(library=tmp_path / "library", database=database_url)


@pytest.fixture
def library(settings, new_library):
    return new_library(settings.library)


@pytest.fixture
def app(settings, library):
    app = create_app(settings, library=library)
    remember_templates(app)
    app.testing = True
    app.test_client_class = Browser
    return app


@pytest.fixture
def owner(library):
    """The account that owns the library."""
    with library.database.write() as session:
        return accounts.ensure_owner(session)


@pytest.fixture
def new_account(library):
    """Make an account with a name, and return its record."""

    def make(name):
        with library.database.write() as session:
            return accounts.create(session, name)

    return make


@pytest.fixture
def sign_in(app):
    """Return a browser in which an account is signed in."""

    def make(account):
        client = app.test_client()
        with client.session_transaction() as session:
            session["_user_id"] = f"{account.id}.{account.epoch}"
            session["session_id"] = uuid4().hex
            session.permanent = True
        return client

    return make


@pytest.fixture
def client(sign_in, owner):
    """A browser in which the owner of the library is signed in."""
    return sign_in(owner)


@pytest.fixture
def stranger(app):
    """A browser that is not signed in."""
    return app.test_client()


@pytest.fixture
def new_map(library):
    """Make a map without photos, shared with others as {account: role}, and return its slug."""

    def make(account, *, name="Park", shared=None):
        with library.database.write() as session:
            record = maps.create(session, name, account_id=account.id)
            for other, role in (shared or {}).items():
                accounts.set_member_role(session, record, account=other, role=role)
        return record.slug

    return make


@pytest.fixture
def park(new_map, owner):
    """The slug of a map of the owner."""
    return new_map(owner)
