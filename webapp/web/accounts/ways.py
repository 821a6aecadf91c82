"""Ways to sign in besides links and passwords, which connections add; one of them can be required."""

from __future__ import annotations

from flask import Flask

from webapp.errors import NotAllowed
from webapp.store.schema import Account
from webapp.web.state import SignInWay, parts


def offered() -> list[SignInWay]:
    """List the ways that the sign-in page offers."""
    return [way for way in parts().sign_in_ways if way.is_offered()]


def required() -> SignInWay | None:
    """Return the way that everybody has to use; None if passwords and links are accepted."""
    return next((way for way in parts().sign_in_ways if way.is_required()), None)


def check_passwords() -> None:
    """Raise NotAllowed if this server accepts no passwords."""
    if required() is not None:
        raise NotAllowed("this server accepts no passwords", hint="sign in by the button")


def check_new_links() -> None:
    """Raise NotAllowed if this server accepts no links from its pages and its API."""
    if required() is not None:
        raise NotAllowed(
            "this server accepts no sign-in links",
            hint="accounts are made when people sign in, and linked on the page of the provider",
        )


def check_link(account: Account) -> None:
    """Raise NotAllowed if an account may not sign in by a link: only owners may where a way is required."""
    if required() is not None and not account.is_owner:
        raise NotAllowed("this server accepts no sign-in links", hint="sign in by the button")


def leave() -> str | None:
    """Return an address where the session of the caller ends elsewhere, too."""
    return next((address for way in parts().sign_in_ways if (address := way.leave()) is not None), None)


def init_app(app: Flask) -> None:
    """Pass the ways to templates."""
    app.add_template_global(offered, "sign_in_ways")
    app.add_template_global(required, "required_way")
