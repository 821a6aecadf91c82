"""The state of a client."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import ExpMapError


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
