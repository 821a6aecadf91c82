"""The application, accounts and a map, as tests of the other pages have them."""

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
