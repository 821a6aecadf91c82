"""What events say to people and to programs."""

from __future__ import annotations

import gettext as gnu_gettext
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from babel.dates import format_datetime

from webapp.render.language import TRANSLATIONS
from webapp.store.outbox import (
    JOB_FAILED,
    ROBOT_HEARD,
    ROBOT_SILENT,
    SHARE_INVITED,
    SHARE_MADE,
    EventDelivery,
)

TEST, CONFIRM = "test", "confirm"
"""Messages besides the events: that of the button, and the one with the code of a new address."""

ACCOUNT_PATH = "/account/events"


def content(delivery: EventDelivery, *, site: str | None) -> dict[str, Any]:
    """Return an event as programs get it.

    Args:
        site: Address of this server, if it is known.
    """
    data: dict[str, Any] = {**delivery.facts, "path": path_of(delivery)}
    if site:
        data["url"] = site.rstrip("/") + data["path"]
    return {
        "id": delivery.event_id,
        "type": delivery.event,
        "timestamp": delivery.at.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "data": data,
    }


def path_of(delivery: EventDelivery) -> str:
    """Return the path of the page that an event is about."""
    facts = delivery.facts
    if facts.get("mission"):
        return f"/missions/{facts['mission']['id']}"
    if facts.get("map"):
        return f"/maps/{facts['map']['slug']}/{'jobs' if delivery.event == JOB_FAILED else 'edit'}"
    return ACCOUNT_PATH if delivery.event in (TEST, CONFIRM) else "/"


def subject_and_text(
    delivery: EventDelivery, *, language: str | None, site: str | None, code: str
) -> tuple[str, str]:
    """Return an event as people read it.

    Args:
        language: Of the account; None for English.
        code: Confirms the address.
    """
    catalogue = _catalogue(language)
    _ = catalogue.gettext
    subject = _subject(delivery, catalogue)
    lines = [f"{subject}.", *_more(delivery, catalogue, language=language or "en")]
    if delivery.event == CONFIRM:
        lines += ["", code, "", _("If you do not expect this, ignore it: nothing more will come.")]
    if site:
        lines += ["", site.rstrip("/") + path_of(delivery)]
    if delivery.event != CONFIRM:
        lines += ["", "-- ", _("You have chosen this message on your account page, where you can end it.")]
    return subject, "\n".join(lines) + "\n"


def _catalogue(language: str | None) -> gnu_gettext.NullTranslations:
    return gnu_gettext.translation("messages", TRANSLATIONS, [language or "en"], fallback=True)


def _subject(delivery: EventDelivery, catalogue: gnu_gettext.NullTranslations) -> str:
    _ = catalogue.gettext
    names = _names(delivery.facts, _("the robot"))
    event = delivery.event
    if event == ROBOT_SILENT:
        return _("%(mission)s: %(robot)s is silent") % names
    if event == ROBOT_HEARD:
        return _("%(mission)s: %(robot)s is heard again") % names
    if event == JOB_FAILED:
        return _("%(place)s: a job failed (%(kind)s)") % names
    if event == SHARE_MADE and delivery.facts.get("public"):
        return _("%(place)s: %(by)s made a public link") % names
    if event == SHARE_MADE:
        return _("%(place)s: %(by)s made a secret link") % names
    if event == SHARE_INVITED:
        return _("The map %(place)s is shared with you") % names
    if event == CONFIRM:
        return _("Confirm this address")
    return _("A test message of Experience Map")


def _more(delivery: EventDelivery, catalogue: gnu_gettext.NullTranslations, *, language: str) -> list[str]:
    _, facts = catalogue.gettext, delivery.facts
    lines = []
    if "silent_since_s" in facts:
        lines.append(_("Last heard: %(time)s") % {"time": _moment(facts["silent_since_s"], language)})
    if "heard_s" in facts:
        lines.append(_("Heard again: %(time)s") % {"time": _moment(facts["heard_s"], language)})
    lines += [_(facts[part]) for part in ("message", "hint") if facts.get(part)]
    if delivery.event == CONFIRM:
        lines.append(_("Enter this code on your account page:"))
    return lines


def _names(facts: Mapping[str, Any], robot: str) -> dict[str, str]:
    place = facts.get("map") or facts.get("mission") or {"name": "Experience Map"}
    return {
        "mission": (facts.get("mission") or {}).get("name", ""),
        "place": place["name"],
        "robot": facts.get("robot") or robot,
        "kind": facts.get("kind", ""),
        "by": facts.get("by") or "?",
    }


def _moment(time_s: float, language: str) -> str:
    return str(format_datetime(datetime.fromtimestamp(time_s, UTC), "medium", locale=language)) + " UTC"
