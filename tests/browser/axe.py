"""Runs axe-core on a page."""

import functools
import gzip
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

AXE = Path(__file__).resolve().parents[1] / "vendor" / "axe" / "axe.min.js.gz"
BAD = ("serious", "critical")
TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


@functools.cache
def _source() -> str:
    return gzip.decompress(AXE.read_bytes()).decode("utf-8")


def findings(page: Page, within: str = "html") -> list[str]:
    """Return the serious and critical findings of axe-core in a part of the page, one line each."""
    page.evaluate(_source())  # through the debugger, which the content security policy does not block
    options = {"runOnly": TAGS, "resultTypes": ["violations"]}
    result: dict[str, Any] = page.evaluate("([part, options]) => axe.run(part, options)", [within, options])
    assert result["passes"], "axe-core checked nothing"
    return [
        f"{found['impact']} {found['id']}: {found['help']}: {node['html'][:200]} {node['failureSummary']}"
        for found in result["violations"]
        if found["impact"] in BAD
        for node in found["nodes"]
    ]
