"""Pages for visitors: a shared map or answer, the same for frames, and the list of public ones."""

from __future__ import annotations

from flask import Blueprint, render_template

from webapp.errors import NotFound
from webapp.store import sharing
from webapp.web import errors
from webapp.web.accounts.security import allow_framing
from webapp.web.context import library, public
from webapp.web.localize.answers import answer_colours
from webapp.web.sharing import shared_state
from webapp.web.state import parts

blueprint = Blueprint("public_pages", __name__)

_SECRET = {"X-Robots-Tag": "noindex, nofollow"}


@blueprint.get("/public")
@public
def index() -> str:
    """List what is open to everybody."""
    with library().database.read() as session:
        more = {name: read(session) for name, read in parts().public_lists.items()}
        return render_template("sharing/public_maps.html", opened=sharing.public(session), **more)


@blueprint.get("/s/<token>")
@public
def show(token: str) -> tuple[str, int, dict[str, str]]:
    """Show a shared map or answer."""
    return _page(token, framed=False)


@blueprint.get("/embed/<token>")
@public
def embed(token: str) -> tuple[str, int, dict[str, str]]:
    """Show it in a frame of another site: no sign-in, no cookie, nothing that could be done for somebody."""
    allow_framing()
    return _page(token, framed=True)


def _page(token: str, *, framed: bool) -> tuple[str, int, dict[str, str]]:
    try:
        with library().database.read() as session:
            opened = sharing.open_share(session, token)
            state = shared_state.of_page(session, opened, token=token)
    except NotFound as error:
        gone = render_template("sharing/gone.html", error=error, framed=framed)
        return gone, errors.status_of(error), _SECRET
    page = render_template(
        "sharing/shared_map.html",
        opened=opened,
        state=state,
        colours=answer_colours(),
        framed=framed,
    )
    return page, 200, {} if opened.share.public_token else _SECRET
