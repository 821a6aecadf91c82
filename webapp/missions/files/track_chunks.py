"""Output of the track readers: pieces of a file, in order, so that no file has to fit into memory."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.records import Poses, Sighting, Source
from webapp.missions.core.trajectory.robotframe import LocalPoses
from webapp.missions.files.drawn import FoundDrawing
from webapp.robot.fields import RECORDS, FieldError

CHUNK = 2048
"""Maximum number of poses in a piece."""

MOST_DRAWN = 500
"""Maximum number of drawings of a file."""

BAD_POSITION = "positions with an invalid latitude or longitude"
BAD_COVARIANCE = "invalid covariances of objects are left out"
UNTIMED = "tracks without times keep only the order of their points"
FEW_TIMES = "times of tracks in which most points have no time"
NO_TIME = "points without a time, in a track that has times"
UNTIMED_OBJECTS = "objects without a time are dated 1970-01-01"


@dataclass(frozen=True, slots=True, eq=False)
class WorldPiece:
    """Poses on the Earth."""

    track: str  # Name of the track in the file, such as a topic; empty if a file has only one
    source: Source
    poses: Poses  # Without `travelled_m`. Positions may be invalid; those are left out later.
    # False if the file has no times for this track: `poses.times_s` then only keeps the order.
    timed: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class RobotPiece:
    """Poses in a robot's frame."""

    track: str
    source: Source
    # `frame`, `body`: Names of the frame of the poses, and of the moving body; empty if the file has none.
    frame: str
    body: str
    poses: LocalPoses  # Finite positions
    timed: bool = True  # As for `WorldPiece`


@dataclass(frozen=True, slots=True)
class WorldObjects:
    """Sightings of objects on the Earth, in the order of the file."""

    sightings: tuple[Sighting, ...]


@dataclass(frozen=True, slots=True)
class LocalSighting:
    """Sighting of an object at a position in a frame; the other attributes are those of `Sighting`."""

    object_id: str | None  # None for a detection without an id, which is associated when it is stored
    kind: str
    time_s: float
    xyz_m: tuple[float, float, float]  # Metres forward, left and up; finite
    confidence: float | None = None
    size_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class RobotObjects:
    """Sightings of objects in the frame of this name in the file."""

    frame: str
    sightings: tuple[LocalSighting, ...]


Piece = WorldPiece | RobotPiece | WorldObjects | RobotObjects


@dataclass(frozen=True, slots=True)
class Skipped:
    """Items that were left out, or are doubtful, for one reason."""

    reason: str  # Kind of the items, and the reason: `sentences with a wrong checksum`
    count: int
    where: str  # Location of the first: a line, a topic, a track

    def __str__(self) -> str:
        """Return the text for display; the count in brackets needs no singular form."""
        return f"{self.reason} ({self.count})"


@dataclass(slots=True)
class Findings:
    """Remarks of a reader: items left out, doubtful ones, notes; drawings of a file, looks of its tracks."""

    # Sentences on how the file was interpreted, without repetition.
    notes: list[str] = field(default_factory=list)
    # Search areas, lines and markers, which are few and small.
    drawn: list[FoundDrawing] = field(default_factory=list)
    # How tracks look, by their names in the file, as far as it says.
    looks: dict[str, TrackLook] = field(default_factory=dict)
    _counts: Counter[str] = field(default_factory=Counter)
    _first: dict[str, str] = field(default_factory=dict)
    _doubts: dict[str, Skipped] = field(default_factory=dict)

    def skip(self, reason: str, *, where: str, count: int = 1) -> None:
        """Count items that are left out."""
        if count:
            self._counts[reason] += count
            self._first.setdefault(reason, where)

    def doubt(self, reason: str, *, where: str, count: int = 1) -> None:
        """Count implausible items that are imported unchanged."""
        if count:
            before = self._doubts.get(reason, Skipped(reason, 0, where))
            self._doubts[reason] = replace(before, count=before.count + count)

    def note(self, sentence: str) -> None:
        """Note how the file was interpreted; empty sentences are ignored."""
        if sentence and sentence not in self.notes:
            self.notes.append(sentence)

    def draw(self, drawing: FoundDrawing | None, *, where: str) -> None:
        """Keep a drawing; None counts as one that is invalid."""
        if drawing is None:
            self.skip("drawings with an invalid shape", where=where)
        elif len(self.drawn) < MOST_DRAWN:
            self.drawn.append(drawing)
        else:
            self.skip("drawings beyond the first 500", where=where)

    def skipped(self) -> tuple[Skipped, ...]:
        """Return what was left out, in order of first occurrence."""
        return tuple(Skipped(reason, self._counts[reason], where) for reason, where in self._first.items())

    def nothing_usable(self) -> str:
        """Return the error message for a file without any usable content."""
        reasons = "; ".join(map(str, self.skipped()))
        return f"nothing in it can be used: {reasons or 'it has no track and no object'}"

    def doubts(self) -> tuple[Skipped, ...]:
        """Return the doubtful items, in order of first occurrence."""
        return tuple(self._doubts.values())


def object_field(name: str, value: object) -> tuple[float, float, float] | None:
    """Return the covariance or size of an object if it is valid in a robot's record, else None."""
    try:
        found: tuple[float, float, float] = RECORDS["object"][name].check(name, value)
    except FieldError:
        return None
    return found
