"""The documentation in `docs/` as HTML, for the web pages."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from webapp.errors import NotFound
from webapp.resources import resource_folder

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from markdown_it.token import Token

CHAPTERS: Mapping[str, Sequence[str]] = {
    "Maps": (
        "make-a-map",
        "editor",
        "first-map",
        "localize",
        "view",
        "dozen-clicks",
        "drone-photos",
        "landmarks",
        "tags",
        "floors",
        "next-photos",
        "panoramas",
        "video",
        "street",
        "photo-libraries",
        "field-forms",
        "satellite",
        "basemaps",
        "gis",
        "stac",
        "georeference",
        "sharing",
        "contributions",
        "field",
    ),
    "Localization": (
        "localization",
        "methods",
        "features",
        "large-maps",
        "scale",
        "measurements",
        "notation",
    ),
    "Robots": (
        "missions",
        "teams",
        "imports",
        "robots",
        "mavlink",
        "ros",
        "foxglove",
        "tak",
        "fusion",
        "mission-exports",
    ),
    "Reference": (
        "commands",
        "python",
        "api",
        "settings",
        "errors",
        "results",
        "photos",
        "track-files",
        "robot-client",
        "ros-nodes",
        "fusion-method",
        "compatibility",
    ),
    "Operating": (
        "install",
        "operating",
        "sign-in",
        "monitoring",
        "events",
        "cluster",
        "cluster-running",
        "s3",
        "dask",
    ),
}
"""Chapters of the manual in their order, by part: names of the files in `docs/`, without extension."""

PICTURES = "pictures"

_NOT_IN_ANCHOR = re.compile(r"[^\w\- ]")


@dataclass(frozen=True, slots=True)
class Chapter:
    name: str
    title: str
    html: str  # Without scripts; headings have the anchors that links within the documentation use


def folder() -> Path:
    return resource_folder("docs")


@functools.cache
def chapter(name: str) -> Chapter:
    if not any(name in names for names in CHAPTERS.values()):
        raise NotFound("the manual has no such chapter", hint="choose one from the list")
    parser = _parser()
    tokens = parser.parse((folder() / f"{name}.md").read_text("utf-8"))
    title = ""
    for heading, content in pairwise(tokens):
        if heading.type == "heading_open":
            title = title or _text(content)
            heading.attrSet("id", _anchor(_text(content)))
    for token in tokens:
        _follow(token.children or [])
        if token.type == "table_open":
            token.attrSet("tabindex", "0")  # can be scrolled by keyboard on narrow screens
        if token.attrs.pop("style", None) == "text-align:right":  # pages allow no inline styles
            token.attrSet("class", "manual__number")
    return Chapter(name, title, parser.renderer.render(tokens, parser.options, {}))


def titles() -> dict[str, list[tuple[str, str]]]:
    """Return the table of contents: name and title of the chapters of each part."""
    return {part: [(name, chapter(name).title) for name in names] for part, names in CHAPTERS.items()}


def _follow(tokens: list[Token]) -> None:
    """Point links and pictures to the pages of the manual; remove links to other files."""
    for token in tokens:
        if token.type == "image":
            token.attrSet("src", f"/help/{PICTURES}/{PurePosixPath(str(token.attrGet('src'))).name}")
            token.attrSet("loading", "lazy")
        if token.type == "link_open":
            target = _address(str(token.attrGet("href")))
            token.attrs = {"href": target} if target else {}


def _address(target: str) -> str | None:
    if target.startswith(("#", "http://", "https://")):
        return target
    path, _, anchor = target.partition("#")
    name = path.removesuffix(".md")
    if not any(name in names for names in CHAPTERS.values()):
        return None
    return f"/help/{name}" + (f"#{anchor}" if anchor else "")


def _text(inline: Token) -> str:
    return "".join(child.content for child in inline.children or [])


def _anchor(title: str) -> str:
    """Return the anchor of a heading, as on GitHub."""
    return _NOT_IN_ANCHOR.sub("", title.lower()).replace(" ", "-")


@functools.cache
def _parser() -> MarkdownIt:
    from markdown_it import MarkdownIt  # here, as it is slow to import and rarely needed

    return MarkdownIt("commonmark", {"html": False}).enable("table")
