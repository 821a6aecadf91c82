"""The web application with a provider, and browsers that sign in there."""

from dataclasses import replace
from urllib.parse import urlsplit

import pytest
import requests

from tests.connect.oidc.provider import CLIENT, SECRET, serving
from tests.quick_apps import remember_templates
from tests.web.conftest import (
    Browser,
    library,
    new_account,
    new_map,
    owner,
    park,
    sign_in,
    stranger,
)
from webapp.app.web import create_app
from webapp.settings import OidcSettings, Settings

__all__ = ["library", "new_account", "new_map", "owner", "park", "sign_in", "stranger"]


@pytest.fixture(scope="session")
def _running():
    with serving() as running:
        yield running


@pytest.fixture
def provider(_running):
    _running.clear()
    return _running


@pytest.fixture
def settings(tmp_path, database_url, provider):
    own = OidcSettings(
        issuer=provider.issuer, client_id=CLIENT, client_secret=SECRET, name="Ranger ID", timeout_s=0.5
    )
    return Settings(library=tmp_path / "library", database=database_url, oidc=own)


@pytest.fixture
def app_with(settings, library):
    """Make the application with changed settings of sign-in."""

    def make(**changed):
        app = create_app(replace(settings, oidc=replace(settings.oidc, **changed)), library=library)
        remember_templates(app)
        app.testing, app.test_client_class = True, Browser
        return app

    return make


@pytest.fixture
def app(app_with):
    return app_with(accounts="everybody")


def path_of(address):
    parts = urlsplit(address)
    return f"{parts.path}?{parts.query}" if parts.query else parts.path


def there(address):
    """Do what a browser does at the provider, and return the path where it comes back."""
    answer = requests.get(address, allow_redirects=False, timeout=5)
    assert answer.status_code == 303, answer.text
    return path_of(answer.headers["Location"])


def enter(browser, *, then=None):
    """Sign a browser in at the provider; returns the last answer."""
    begun = browser.get("/oidc/start", query_string={"next": then} if then else {})
    assert begun.status_code == 303, begun.text
    return browser.get(there(begun.headers["Location"]))
