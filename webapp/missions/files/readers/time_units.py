"""The unit of times that are plain numbers: one rule for all formats whose files do not state it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_PER_SECOND = (("nanoseconds", 1e9, 1e17), ("microseconds", 1e6, 1e14), ("milliseconds", 1e3, 1e11))
"""Units by name, how many are a second, and the least times in them: those of 1973."""

_LEAST = _PER_SECOND[-1][2]

LAST_S = 253_402_300_800.0
"""The year 10000: later numbers are no times."""


def per_second(times: ArrayLike) -> float:
    """Infer how many units of times since 1970 are a second, from their median; 1 for seconds."""
    values = np.abs(np.asarray(times, dtype=np.float64))
    values = values[np.isfinite(values)]
    return ticks(float(np.median(values))) if len(values) else 1.0


def ticks(time: float) -> float:
    """Infer how many units of one time are a second."""
    if not abs(time) >= _LEAST:  # also NaN
        return 1.0
    return next(count for _, count, least in _PER_SECOND if abs(time) >= least)


def unit_remark(count: float, example: float) -> str:
    """Return the note on an inferred unit, as returned by `per_second`; empty for seconds."""
    unit = next((name for name, known, _ in _PER_SECOND if known == count), "")
    return f"times such as {example:.0f} were read as {unit} since 1970" if unit else ""
