"""Options of a robot's client, and its status."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import ExpMapError


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """Options; the defaults suit a robot with an SD card and a weak network."""

    sync_s: float = 0.5
    """Seconds of records that a power cut can lose at most; 0 syncs each before `pose` returns."""

    every_s: float | None = 2.0
    """Seconds between two uploads; None uploads on `upload()`, `end()` and `close()` only."""

    min_move: str = "0"
    """Leave out poses within this distance of the last one kept: `0.5m`, `0.00001deg`; `0` keeps all."""

    limit_mb: float = 1000.0
    """Megabytes (10^6 bytes) of records and photos in the spool; acknowledged records are deleted first."""

    batch_records: int = 1000
    """Maximum number of records in one request."""

    batch_kb: float = 500.0
    """Maximum size of one request, kilobytes (10^3 bytes)."""

    timeout_s: float = 10.0
    """Seconds without a response after which the network counts as down."""

    backoff_s: float = 1.0
    """Delay after the first failure, seconds; each further failure doubles it."""

    backoff_max_s: float = 60.0
    """Upper bound of that delay, seconds."""


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The state of a client."""

    written: int  # Number of records since the spool was created
    waiting: int  # Number of records that the server has not acknowledged
    photos: int  # Number of photos waiting
    online: bool | None  # Whether the last request was answered; None before the first one
    problem: str  # Why the last upload failed; empty if it did not
    refused: ExpMapError | None  # Why the server refuses all requests: an unknown token, a deleted mission
