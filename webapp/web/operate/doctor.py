"""The page *Server > Check* of the owner: what `expmap doctor` finds."""

from __future__ import annotations

from apiflask import APIBlueprint
from flask import render_template
from flask_babel import gettext as _
from flask_babel import lazy_gettext as _l

from webapp.errors import NotAllowed
from webapp.tasks.operate import doctor
from webapp.web.context import account, settings
from webapp.web.pages import page

pages = APIBlueprint("doctor_pages", __name__, url_prefix="/server/check", enable_openapi=False)

LABELS = {
    "python": _l("Python"),
    "packages": _l("Packages"),
    "opencv": _l("OpenCV"),
    "extras": _l("Optional parts"),
    "models": _l("Models"),
    "machine": _l("Machine"),
    "outgoing proxy": _l("Proxy for requests to services"),
    "library": _l("Library"),
    "permissions": _l("Permissions"),
    "disk": _l("Disk"),
    "file system": _l("File system"),
    "object storage": _l("Object storage"),
    "database": _l("Database"),
    "clock": _l("Clock"),
    "jobs": _l("Jobs"),
    "maps": _l("Maps"),
}
"""Names of the checks; what they find is in the words of the command line."""


@pages.before_request
def only_owners() -> None:
    """Allow only owners of the library."""
    if not account().is_owner:
        raise NotAllowed(_("only the owner of the library may do this"))


@pages.get("")
@page(chapter="operating#when-something-is-wrong")
def show() -> str:
    """Check the installation and the library, what needs something done first."""
    order = ("failing", "warning", "ok")
    found = [*doctor.check_installation(settings()), *doctor.check_library(settings())]
    checks = sorted(found, key=lambda check: order.index(check.state))
    return render_template("operate/doctor.html", checks=checks, labels=LABELS)
