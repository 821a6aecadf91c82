"""Computes figures from the output of programs, and formats tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

STAGES = ("read", "extract", "retrieve", "verify", "position", "total")

Row = Mapping[str, Any]
Cell = Callable[[Row], str]


def percentile(values: Sequence[float], percent: float) -> float | None:
    """Return a percentile with linear interpolation between the sorted values; None without values."""
    if not values:
        return None
    ordered = sorted(values)
    place = (len(ordered) - 1) * percent / 100.0
    low = math.floor(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson, JASA 22, 1927)."""
    share, z2 = hits / count, 1.96**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = 1.96 * math.sqrt(share * (1 - share) / count + z2 / (4 * count**2)) / (1 + z2 / count)
    return max(0.0, middle - half), min(1.0, middle + half)


def stage_seconds(answers: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Return the median seconds of each stage, as `stage_read` and so on.

    Args:
        answers: Output of `localize --json`; answers with an error are left out.
    """
    times = [answer["seconds"] for answer in answers if "seconds" in answer]
    known = {stage: [t[stage] for t in times if t.get(stage) is not None] for stage in STAGES}
    return {f"stage_{stage}": percentile(seconds, 50) for stage, seconds in known.items()}


def strangers(answers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise false positives on photos that were taken elsewhere.

    Parameters
    ----------
    answers : sequence of mapping
        Output of `localize --json`, with at least one answer without an error.

    Returns:
    -------
    dict
        Number of photos; number placed with a probability of at least 0.5, their share and its 95 % interval;
        largest probability and the 99 % quantile; median of "not on this map". A photo's probability is that
        of its most probable place, 0 without a place.
    """
    used = [answer for answer in answers if "error" not in answer]
    sure = [max((h["probability"] for h in a["hypotheses"]), default=0.0) for a in used]
    off = [a["off_map_probability"] for a in used if a.get("off_map_probability") is not None]
    placed = sum(p >= 0.5 for p in sure)
    return {
        "foreign_photos": len(used),
        "foreign_failed": len(answers) - len(used),
        "foreign_placed": placed,
        "foreign_share": placed / len(used),
        "foreign_interval": list(wilson(placed, len(used))),
        "foreign_largest": max(sure),
        "foreign_q99": percentile(sure, 99),
        "foreign_off_map_p50": percentile(off, 50),
    }


def refused_though_right(queries: Sequence[Mapping[str, Any]], right_px: float) -> float | None:
    """Return the share of queries that are "not on this map" though their first hypothesis is right.

    Args:
        queries: `per_query` of `evaluate --json`.
    """
    refused = 0
    for query in queries:
        answer, error = query["answer"], query["error_px"]
        off, places = answer.get("off_map_probability"), answer.get("hypotheses")
        lost = bool(places) and off is not None and off > places[0]["probability"]
        refused += lost and error is not None and error <= right_px
    return ratio(refused, len(queries))


def mean_seconds(queries: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the mean time of a query; None without any that could be read."""
    times = [query["answer"]["seconds"]["total"] for query in queries if "seconds" in query["answer"]]
    return ratio(sum(times), len(times))


def per_photo_kb(peak_mb: float, one_photo_mb: float, *, photos: int) -> float:
    """Return the memory per map photo, 1000 bytes: the peak minus that with a map of one photo."""
    return (peak_mb - one_photo_mb) * 2**20 / 1000.0 / photos


def each(large: float, small: float, *, more: int) -> float | None:
    """Return the cost per additional query, from two runs that differ by `more` queries; None if 0."""
    return (large - small) / more if more > 0 else None


def ratio(value: float | None, base: float | None) -> float | None:
    """Return the quotient; None if a value is unknown or the base is 0."""
    return None if value is None or not base else value / base


def plain(key: str, digits: int = 3, *, times: float = 1.0) -> Cell:
    """Return the formatter of a column of numbers."""
    return lambda row: "-" if row.get(key) is None else f"{row[key] * times:.{digits}f}"


def with_interval(key: str) -> Cell:
    """Return the formatter of a column of figures with 95 % intervals, from `intervals_95`."""

    def cell(row: Row) -> str:
        if row.get(key) is None:
            return "-"
        interval = row.get("intervals_95", {}).get(key)
        return f"{row[key]:.3f}" + ("" if interval is None else f" {_interval(interval)}")

    return cell


def placed(row: Row) -> str:
    """Format the cell of photos from elsewhere that were placed."""
    if row.get("foreign_photos") is None:
        return "-"
    share, interval = row["foreign_share"], _interval(row["foreign_interval"])
    return f"{row['foreign_placed']}/{row['foreign_photos']} = {share:.3f} {interval}"


def _interval(interval: Sequence[float]) -> str:
    return "[{:.2f} {:.2f}]".format(*interval)


def table(title: str, columns: Mapping[str, Cell], rows: Sequence[Row]) -> str:
    """Format rows as a text table with aligned columns."""
    head = [title, *columns]
    lines = [head, *([row["name"], *(cell(row) for cell in columns.values())] for row in rows)]
    wide = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(
            text.rjust(w) if i else text.ljust(w) for i, (text, w) in enumerate(zip(line, wide, strict=True))
        )
        for line in lines
    )
