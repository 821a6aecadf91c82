"""Requests addresses of the web application, and measures the response times."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any
from uuid import uuid4

import numpy as np

from webapp.app.web import create_app
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import Account


def reader(library: Library, settings: Settings, account: Account) -> Callable[[str], Any]:
    """Return a function that requests an address as an account, without a network."""
    client = create_app(settings, library=library).test_client()
    with client.session_transaction() as session:
        session["_user_id"] = f"{account.id}.{account.epoch}"
        session["session_id"] = uuid4().hex

    def get(address: str) -> Any:
        answer = client.get(address)
        assert answer.status_code == 200, answer.get_data(as_text=True)
        return answer

    return get


def timed(get: Callable[[str], Any], addresses: list[str]) -> dict[str, float]:
    """Request addresses; the first one is requested once more before, to warm up.

    Returns:
    -------
    dict of str to float
        Median, 95th percentile and processor time, milliseconds, and the size of the last answer.
    """
    seconds, processor_s = [], []
    get(addresses[0])
    for address in addresses:
        begin, worked = time.perf_counter(), time.process_time()
        answer = get(address)
        seconds.append(time.perf_counter() - begin)
        processor_s.append(time.process_time() - worked)
    p50, p95 = np.quantile(seconds, [0.5, 0.95]) * 1000
    return {
        "p50_ms": round(p50, 1),
        "p95_ms": round(p95, 1),
        "processor_ms": round(float(np.median(processor_s)) * 1000, 1),
        "kb": round(len(answer.data) / 1000, 1),
    }
