"""What a view states about its page; template variables and filters of all pages; helpers for forms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from decimal import Decimal
from typing import Any, TypeVar
from urllib.parse import urlsplit

from flask import Flask, current_app, redirect, request, url_for
from flask_babel import LazyString, format_date, format_datetime, format_decimal, format_timedelta
from werkzeug.wrappers import Response

from webapp.core.texts import significant
from webapp.extras import is_installed
from webapp.files.decode import IMAGE_FORMATS
from webapp.files.exchange import gpx, map_zip
from webapp.files.localize import models
from webapp.files.maps import positions
from webapp.files.photos import sidecars
from webapp.files.satellite.georeference_files import CORNER_SUFFIX, worldfile_suffixes
from webapp.files.video import clip, subtitles
from webapp.store.clock import now
from webapp.web import language
from webapp.web.accounts import sessions
from webapp.web.state import ExportLink, parts, settings

_THEMES = ("light", "dark")
_MARK = "_expmap_page"
FIRST_CHAPTER = "make-a-map#1-a-new-map-and-its-image"
"""The chapter after the installation: readers of the manual are already signed in."""

_IMAGE_SUFFIXES = [suffix for entry in IMAGE_FORMATS.values() for suffix in entry.suffixes]
_IMAGE_TYPES = [kind for entry in IMAGE_FORMATS.values() for kind in entry.media_types]


def _field(*parts: Iterable[str]) -> str:
    return ",".join(dict.fromkeys(part for some in parts for part in some))


ACCEPTED: Mapping[str, str] = {
    "photos": _field(["image/*"], _IMAGE_SUFFIXES),
    "photos_and_sidecars": _field(["image/*"], _IMAGE_SUFFIXES, sorted(sidecars.SUFFIXES)),
    "sidecars": _field(sorted(sidecars.SUFFIXES)),
    # No `image/*`: with it, phones offer the gallery only, where no GeoTIFF is.
    "map_images": _field(_IMAGE_TYPES, _IMAGE_SUFFIXES),
    "world_files": _field(*map(worldfile_suffixes, _IMAGE_SUFFIXES), ["text/plain"]),
    "corners": _field([CORNER_SUFFIX], ["application/json"]),
    "positions": _field(positions.SUFFIXES),
    "field_forms": _field([map_zip.SUFFIX, ".csv", ".gpkg"]),
    "tracks_of_photos": _field([gpx.SUFFIX]),
    "videos": _field(["video/*"], clip.SUFFIXES),
    "tracks_of_videos": _field([gpx.SUFFIX, subtitles.SUFFIX]),
    "map_zips": _field([map_zip.SUFFIX], ["application/zip"]),
    "models": _field([models.SUFFIX]),
    "shapes": _field([".geojson", ".json", ".kml"]),  # read by the page itself
}
"""Values of the attribute `accept`, by what is chosen; for missions: `accepted` of their readers."""


View = TypeVar("View", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class Tab:
    """An entry of the navigation between the pages of a map."""

    label: LazyString
    icon: str  # of static/img/icons.svg
    order: int  # from the left


@dataclass(frozen=True, slots=True)
class PageEntry:
    """What a view states about its page."""

    chapter: str  # of the manual, with its anchor: opened by the question mark
    tab: Tab | str | None  # its own, or the endpoint of the page to whose tab it belongs


def page(*, chapter: str = FIRST_CHAPTER, tab: Tab | str | None = None) -> Callable[[View], View]:
    """Mark a view as a page for people; a decorator to be placed directly below the route."""

    def mark(view: View) -> View:
        setattr(view, _MARK, PageEntry(chapter, tab))
        return view

    return mark


def page_entry(view: Callable[..., Any] | None) -> PageEntry | None:
    """Return what a view states about its page; None if it is none."""
    return getattr(view, _MARK, None)


def init_app(app: Flask) -> None:
    """Pass the account, the language and the filters of times, numbers and messages to all templates."""
    app.context_processor(_common)
    app.add_template_filter(_sentence, "sentence")
    app.add_template_filter(language.translate, "translate")
    app.add_template_filter(_ago, "ago")
    app.add_template_filter(_exact, "exact")
    app.add_template_filter(_day, "day")
    app.add_template_filter(format_decimal, "decimal")
    app.add_template_filter(_significant, "significant")


def _significant(value: float) -> str:
    """Format a number with three significant digits; Babel's own pattern for this, `@##`, cuts small ones."""
    return str(format_decimal(Decimal(significant(value)), "#,##0.############"))


def map_tabs() -> list[tuple[str, Tab]]:
    """List the tabs of a map in their order, with the endpoints of their pages."""
    entries = ((name, page_entry(view)) for name, view in current_app.view_functions.items())
    tabs = [(name, entry.tab) for name, entry in entries if entry and isinstance(entry.tab, Tab)]
    return sorted(tabs, key=lambda one: one[1].order)


def export_links(kind: str) -> tuple[ExportLink, ...]:
    """List what connections add to the export menu of a "map" or a "mission"."""
    return parts().exports.get(kind, ())


def _current() -> tuple[str, PageEntry] | None:
    """Return endpoint and entry of the page that is shown.

    A form that is shown again after an error has an address below that of its page.
    """
    rule = request.url_rule.rule if request.url_rule else ""
    above = [one for one in current_app.url_map.iter_rules() if rule.startswith(one.rule)]
    for one in sorted(above, key=lambda one: -len(one.rule)):
        entry = page_entry(current_app.view_functions[one.endpoint])
        if entry is not None:
            return one.endpoint, entry
    return None


def _current_tab() -> str | None:
    """Return the endpoint of the page whose tab is marked as the current one."""
    found = _current()
    return None if found is None else found[1].tab if isinstance(found[1].tab, str) else found[0]


def help_address() -> str:
    """Return the URL of the chapter that explains the current page."""
    found = _current()
    return f"/help/{found[1].chapter if found else FIRST_CHAPTER}"


def _common() -> dict[str, Any]:
    theme = request.cookies.get("expmap-theme")
    return {
        "accepted": ACCEPTED,
        "account": sessions.signed_in(),
        "installed": is_installed,
        "language": language.current(),
        "languages": language.LANGUAGES,
        "help_address": help_address,
        "map_tabs": map_tabs,
        "export_links": export_links,
        "current_tab": _current_tab,
        "script_catalogue": language.script_catalogue,
        "theme": theme if theme in _THEMES else None,
    }


def _sentence(text: str) -> str:
    """Capitalise the first letter: messages begin with a small one, as is usual in a terminal."""
    return text[:1].upper() + text[1:]


def _ago(when: datetime) -> str:
    return str(format_timedelta(when - now(), granularity="second", add_direction=True))


def _exact(when: datetime) -> str:
    return str(format_datetime(when, "medium"))


def _day(date: str) -> str:
    """Format a day given as YYYY-MM-DD; another text is returned as it is."""
    try:
        return str(format_date(datetime.fromisoformat(date), "full"))
    except ValueError:
        return date


def text(name: str) -> str:
    """Return a field of the form, or an empty text if it is missing."""
    return request.form.get(name, "")


def own_path(address: str | None) -> str | None:
    """Return path and query of a URL from a client, to prevent redirects to other sites.

    Returns:
        None if it is not a path of this site.
    """
    parts = urlsplit((address or "").replace("\\", "/"))
    if not parts.path.startswith("/") or parts.path.startswith("//"):
        return None
    return f"{parts.path}?{parts.query}" if parts.query else parts.path


def site() -> str:
    """Return the address of this server, as browsers know it."""
    return (settings().events.site or request.host_url).rstrip("/")


def back(endpoint: str, **values: Any) -> Response:
    """Redirect to a page after a form was processed, so that a reload does not submit it again."""
    return redirect(url_for(endpoint, **values), code=303)
