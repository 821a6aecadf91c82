"""The fixtures of the web application."""

from tests.web.conftest import (
    app,
    client,
    library,
    new_account,
    owner,
    settings,
    sign_in,
    stranger,
)

__all__ = ["app", "client", "library", "new_account", "owner", "settings", "sign_in", "stranger"]
