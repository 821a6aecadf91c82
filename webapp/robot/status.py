"""How far a client is."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import ExpMapError


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """How far a client is.

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
        Why the last upload did not go on; empty where it did.
    refused : ExpMapError or None
        What the server has against all of it: a token that it does not know, a mission that is gone.
    """

    written: int
    waiting: int
    photos: int
    online: bool | None
    problem: str
    refused: ExpMapError | None
