"""The application, accounts and a map, as in the tests of other pages."""

from tests.web.conftest import (
    app,
    client,
    library,
    new_account,
    new_map,
    owner,
    park,
    settings,
    sign_in,
    stranger,
)

__all__ = [
    "app",
    "client",
    "library",
    "new_account",
    "new_map",
    "owner",
    "park",
    "settings",
    "sign_in",
    "stranger",
]
