"""Waiting for what a page shows."""

import time
from typing import Any

from playwright.sync_api import Page

PATIENCE_S = 60.0


def until(page: Page, script: str, value: Any = None) -> None:
    """Wait until a script returns true.

    Page.wait_for_function evaluates its script within the page, which the content security policy forbids.
    """
    end = time.monotonic() + PATIENCE_S
    while not page.evaluate(script, value):
        assert time.monotonic() < end, script
        page.wait_for_timeout(100)
