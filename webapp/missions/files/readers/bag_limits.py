"""Limits within bags, in addition to those of the process that reads them, and the times of their messages.

rosbags decompresses chunks of any size, generates code in proportion to the lengths of arrays in message
definitions, and reads any SQLite database.

Times are those of the messages' headers, unless these cannot be right: a header may have no stamp, the time
since a start, or one in a wrong unit, while the recorder had the right time. The stamps of a bag that was
recorded while another one was played are long before the recording.
"""

from __future__ import annotations

import bz2
import statistics
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from webapp.errors import TrackError
from webapp.extras import extra
from webapp.files.exchange.times import utc
from webapp.missions.files.track_chunks import Findings

if TYPE_CHECKING:
    import apsw
    from rosbags.interfaces import Connection
    from rosbags.interfaces.typing import Typesdict
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2


MAX_CHUNK = 128_000_000
"""Bytes of a decompressed chunk, and of a message in SQLite. Recorders usually write chunks of 1 to 8 MB."""

_SMALL_CHUNK, _MAX_RATIO = 16_000_000, 250
"""Larger chunks may not be compressed more than this: blank images in a small one are."""

MAX_DEFINITION = 300_000
"""Characters of a message definition with all that it contains; the longest of usual packages has 60000."""

MAX_DEFINITIONS = 5_000_000
"""Characters of all different definitions."""

MAX_ARRAY = 1000
"""Length of a fixed array of texts or messages; those of numbers may have any."""

_ARRAY, _BASE, _TEXTS = 3, 1, ("string", "wstring")
_TABLE_LIKE = "type = 'index' OR (type = 'table' AND rootpage > 0)"


class _Decompressor(Protocol):
    """Decompressor of one frame of `lz4`, `bz2` or `zstd`."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes | None: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


def unpacked(data: bytes, *, size: int, start: Callable[[], _Decompressor]) -> bytes:
    """Decompress a chunk, and stop once it is larger than it should be.

    Args:
        size: Size of the decompressed chunk that the bag states.
        start: Makes the decompressor of a frame; a chunk may have several.

    Raises:
        TrackError: The size is beyond the limits, or wrong.
    """
    if size > MAX_CHUNK or (size > _SMALL_CHUNK and size > _MAX_RATIO * len(data)):
        raise TrackError(
            f"a chunk of the bag claims to hold {size / 1e6:.0f} MB in {len(data)} bytes",
            hint="record it again in smaller chunks",
        )
    parts: list[bytes] = []
    found, rest = 0, data
    while rest:
        frame = start()
        part = frame.decompress(rest, size - found + 1)
        parts.append(part)
        found += len(part)
        if found > size or not frame.eof:
            break
        rest = frame.unused_data or b""
    if found != size:
        raise TrackError("a chunk of the bag has another size than it should", hint="it is damaged")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def limited_reader1(path: Path, *, used: Collection[str]) -> Reader1:
    """Return a reader of a ROS 1 bag that checks its chunks, and the definitions of the used types."""
    with extra("missions"):
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
        from rosbags.rosbag1 import Reader
        from rosbags.rosbag1.reader import Chunk, Header, RecordType

    starts = {"lz4": LZ4FrameDecompressor, "bz2": bz2.BZ2Decompressor}

    class Limited(Reader):
        """Knows the decompressed size of each chunk, from its header."""

        def read_chunk(self) -> Chunk:
            assert self.bio is not None
            at = self.bio.tell()
            header = Header.read(self.bio, RecordType.CHUNK)
            self.bio.seek(at)
            chunk = super().read_chunk()
            start = starts.get(header.get_string("compression"))
            if start is None:
                return chunk
            return chunk._replace(decompressor=partial(unpacked, size=header.get_uint32("size"), start=start))

        def open(self) -> None:
            super().open()
            _check_or_close(self, self.connections, used=used)

    return Limited(path)


def limited_reader2(path: Path, *, used: Collection[str]) -> Reader2:
    """Return a reader of a ROS 2 bag that checks its chunks, tables, and the definitions of the used types.

    It changes how rosbags decompresses and opens databases in this process.
    """
    with extra("missions"):
        import apsw
        from rosbags.rosbag2 import Reader, storage_mcap

    # rosbags passes the stated size, but its own functions ignore it
    for name, start in mcap_decompressors().items():
        storage_mcap.DECOMPRESSORS[name] = partial(_unpacked_mcap, start=start)
    if check_database not in apsw.connection_hooks:
        apsw.connection_hooks.append(check_database)

    class Limited(Reader):
        """Checks the definitions before they are used."""

        def open(self) -> None:
            super().open()
            _check_or_close(self, self.storage.connections, used=used)

    return Limited(path)


def mcap_decompressors() -> dict[str, Callable[[], _Decompressor]]:
    """Return what makes the decompressor of a chunk of MCAP, by the name of its compression."""
    with extra("missions"):
        from lz4.frame import LZ4FrameDecompressor
        from rosbags.rosbag2 import storage_mcap

    # its zstd is that of the Python version
    return {"lz4": LZ4FrameDecompressor, "zstd": vars(storage_mcap)["zstd"].ZstdDecompressor}


def _unpacked_mcap(data: bytes, size: int, *, start: Callable[[], _Decompressor]) -> bytes:
    return unpacked(data, size=size, start=start)


def _check_or_close(
    reader: Reader1 | Reader2, connections: list[Connection], *, used: Collection[str]
) -> None:
    """Check the definitions of used types; the others are dropped, so that nobody has to understand them."""
    with extra("missions"):
        from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

    none = MessageDefinition(MessageDefinitionFormat.NONE, "")
    try:
        connections[:] = [
            one if one.msgtype in used else one._replace(msgdef=none, digest="") for one in connections
        ]
        check_definitions(connections)
    except BaseException:
        reader.close()
        raise


def check_definitions(connections: Iterable[Connection]) -> None:
    """Reject message definitions from which rosbags would generate very much code. Raises TrackError."""
    different = {(one.msgtype, one.msgdef) for one in connections}
    if sum(len(definition.data) for _, definition in different) > MAX_DEFINITIONS:
        raise TrackError(f"the bag has more than {MAX_DEFINITIONS} characters of message definitions")
    for kind, definition in sorted(different, key=lambda one: one[0]):
        if len(definition.data) > MAX_DEFINITION:
            raise TrackError(f"a message definition is longer than {MAX_DEFINITION} characters", where=kind)
        _check_arrays(_parsed(kind, definition), where=kind)


def _parsed(kind: str, definition: Any) -> Typesdict:
    """Parse a definition as `AnyReader` does."""
    with extra("missions"):
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if definition.format == MessageDefinitionFormat.NONE or "[" not in definition.data:
        return {}
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, kind)
    line = "=" * 80 + "\n"
    parts = [part.partition("\n")[2] for part in definition.data.split(line)[1:]] or [definition.data]
    return {name: fields for part in parts for name, fields in get_types_from_idl(part).items()}


def _check_arrays(types: Typesdict, *, where: str) -> None:
    for _, fields in types.values():
        for name, (node, about) in fields:
            if node != _ARRAY:
                continue
            element, length = about[0], about[1]
            unrolled = element[0] != _BASE or element[1][0] in _TEXTS
            if unrolled and int(length) > MAX_ARRAY:
                raise TrackError(
                    f"the message definition has an array of {length} elements, and the limit is {MAX_ARRAY}",
                    where=f"{where} {name[:80]}",
                )


def check_database(connection: apsw.Connection) -> None:
    """Limit what a database of somebody else can do, and reject one that has more than tables and indexes.

    A view, a trigger, a generated column or a virtual table could compute anything while it is read. Raises
    TrackError.
    """
    with extra("missions"):
        import apsw

    connection.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
    connection.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)
    connection.config(apsw.SQLITE_DBCONFIG_ENABLE_TRIGGER, 0)
    connection.config(apsw.SQLITE_DBCONFIG_DEFENSIVE, 1)
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
    connection.limit(apsw.SQLITE_LIMIT_ATTACHED, 0)
    connection.pragma("query_only", True)
    connection.pragma("cell_size_check", True)
    other = connection.execute(f"SELECT name FROM sqlite_schema WHERE NOT ({_TABLE_LIKE})").fetchone()
    computed = connection.execute(
        "SELECT t.name FROM sqlite_schema AS t, pragma_table_xinfo(t.name) AS c "
        "WHERE t.type = 'table' AND c.hidden > 0"
    ).fetchone()
    for found, what in ((other, "a view or a trigger"), (computed, "a computed column")):
        if found is not None:
            raise TrackError(f"the database has {what}, which no recorder makes", where=str(found[0])[:80])


_FIRST_S = 946_684_800.0
"""2000-01-01: robots with a clock have later times."""

_DAY_S = 86_400.0
_APART_S = 3600.0
"""Stamps this far from the recording are mentioned."""

_JUMP_S = 60.0
"""Change of the time between stamp and recording from one message to the next, of stamps that jump."""

_LEAST_JUMPS = 3
"""Fewer are single odd stamps, each of which makes two, or a clock that was set."""

NO_STAMP = "messages without a time stamp, which have the time of their recording"
BAD_STAMP = "messages whose time stamp cannot be right, which have the time of their recording"
BACK = "time stamps that jump back, while the recording goes on"

Stamp = tuple[float, float]
"""Time of a header, and of the recording: seconds since 1970."""


def is_possible(stamp_s: float, recorded_s: float) -> bool:
    """Return whether a stamp can be right, by when its message was recorded."""
    return recorded_s < _FIRST_S or _FIRST_S <= stamp_s <= recorded_s + _DAY_S


@dataclass(slots=True)
class TopicClock:
    """Decides on the times of a topic's messages."""

    topic: str
    trusts_stamps: bool = True
    last: dict[tuple[str, str], Stamp] = field(default_factory=dict)  # By frames, as of several robots

    def trusts(self, stamp_s: float, recorded_s: float) -> bool:
        return self.trusts_stamps and is_possible(stamp_s, recorded_s)

    def time(
        self, stamp_s: float | None, recorded_s: float, *, frames: tuple[str, str], findings: Findings
    ) -> float:
        """Return the time of a message; its stamp is None if it has none."""
        if stamp_s is None:
            findings.doubt(NO_STAMP, where=self.topic)
            return recorded_s
        if not self.trusts(stamp_s, recorded_s):
            findings.doubt(BAD_STAMP, where=f"{self.topic}, {utc([stamp_s])[0][:10]}")
            return recorded_s
        before_s, before_recorded_s = self.last.get(frames, (stamp_s, recorded_s))
        if stamp_s < before_s - _JUMP_S and recorded_s >= before_recorded_s:
            findings.doubt(BACK, where=self.topic)
        self.last[frames] = (stamp_s, recorded_s)
        return stamp_s


def clock_of(topic: str, series: Sequence[Sequence[Stamp]], *, findings: Findings) -> TopicClock:
    """Decide by the first stamps of a topic, in a series for each of its pairs of frames."""
    stamps = [stamp for one in series for stamp in one]
    ahead = [stamp_s - recorded_s for stamp_s, recorded_s in stamps]
    if not stamps:
        return TopicClock(topic)
    steps = [abs((b[0] - b[1]) - (a[0] - a[1])) for one in series for a, b in pairwise(one)]
    possible = sum(is_possible(*stamp) for stamp in stamps)
    jumping = sum(step > _JUMP_S for step in steps)
    if 2 * possible < len(stamps) or (jumping >= _LEAST_JUMPS and 2 * jumping > len(steps)):
        return TopicClock(topic, trusts_stamps=False)
    usual = statistics.median(ahead)
    if abs(usual) > _APART_S:
        side = "after" if usual > 0.0 else "before"
        findings.note(
            f"the time stamps of {topic} are {_span(abs(usual))} {side} the recording: the stamps count"
        )
    return TopicClock(topic)


def _span(seconds: float) -> str:
    hours = seconds / 3600.0
    return f"{hours:.1f} hours" if hours < 48.0 else f"{hours / 24.0:.0f} days"
