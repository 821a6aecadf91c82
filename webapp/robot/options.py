"""Options of a robot's client, and its status."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import ExpMapError


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """Choices with defaults that suit a robot with an SD card and a weak network."""

    sync_s: float = 0.5
    """Seconds whose records a power cut can cost at most; 0 syncs each before `pose` returns."""

    every_s: float | None = 2.0
    """Seconds between two uploads; None uploads on `upload()`, `end()` and `close()` only."""

    min_move: str = "0"
    """Leave out poses within this of the last one kept: `0.5m`, `0.00001deg`; `0` keeps all."""

    limit_mb: float = 1000.0
    """Megabytes (10^6 bytes) of records and photos in the spool. What the server has goes first."""

    batch_records: int = 1000
    """Records in one request, at most."""

    batch_kb: float = 500.0
    """Kilobytes (10^3 bytes) of one request, at most."""

    timeout_s: float = 10.0
    """Seconds without an answer of the server after which the network counts as down."""

    backoff_s: float = 1.0
    """Wait after the first failure; it doubles with each further one, ..."""

    backoff_max_s: float = 60.0
    """... up to this."""


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The state of a client.

    Attributes
    ----------
    written : int
        Records since the spool was begun.
    waiting : int
        Of them, how many the server has not acknowledged.
    photos : int
        Photos that wait.
    online : bool or None
        Whether the last request was answered; None before the first one.
    problem : str
        Why the last upload failed; empty where it did not.
    refused : ExpMapError or None
        Why the server refuses everything: an unknown token, a deleted mission.
    """

    written: int
    waiting: int
    photos: int
    online: bool | None
    problem: str
    refused: ExpMapError | None
