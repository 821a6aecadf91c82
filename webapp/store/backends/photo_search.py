"""Search for similar photos in PostgreSQL by pgvector, so that no process holds the vectors in memory.

The rows are derived from the library's records (`map_vectors`) and updated after them. Until the rows of a
map exist and are up to date, it is compared in memory.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import DBAPIError

if TYPE_CHECKING:  # processes that only start others do without NumPy
    import numpy as np
    from numpy.typing import NDArray

_log = logging.getLogger(__name__)

TABLES = frozenset({"photo_vector", "searchable_map"})
"""Derived tables, which are not copied with the records."""

NEAREST = 1000
"""Nearest photos of all maps by which likely maps are found; the index keeps as many candidates."""

COMPARED = 3
"""The likeness of a map is the mean of this many best photos: a single one may be similar by chance."""

_FEW = 50_000
"""Number of photos up to which all are compared, without the index."""

_NOT_COMPARED = -2.0
"""Added to the estimated likeness of a map, so that it is ranked after the maps that were compared."""

_OLDEST = (0, 8)
"""Oldest supported pgvector: its iterative scans continue when the filter by maps drops results."""

_DIMENSIONS, _SHA256_BYTES, _LOCK = 128, 32, 0x657870
_NO_EXTENSION = ("0A000", "42501", "58P01")
"""Error codes of PostgreSQL: the server lacks the extension, or the account may not create it."""

_UNLIMITED = "SET LOCAL statement_timeout = 0"
_IS_THERE = """
SELECT to_regclass('searchable_map') IS NOT NULL
       AND EXISTS (SELECT FROM pg_extension WHERE extname = 'vector')
"""
_CAN = """
SELECT EXISTS (SELECT FROM pg_extension WHERE extname = 'vector') OR (
    current_setting('is_superuser') = 'on'
    AND EXISTS (SELECT FROM pg_available_extensions WHERE name = 'vector')
)
"""
_ANY = "SELECT FROM map_vectors LIMIT 1"
_VERSION = "SELECT extversion FROM pg_extension WHERE extname = 'vector'"
_ADD_EXTENSION = "CREATE EXTENSION IF NOT EXISTS vector"
_MAKE = (
    f"""
    CREATE TABLE IF NOT EXISTS photo_vector (
        map_id integer, basis_id integer, content bytea, vector halfvec({_DIMENSIONS}) NOT NULL,
        PRIMARY KEY (map_id, basis_id, content)
    )
    """,
    """
    CREATE TABLE IF NOT EXISTS searchable_map (
        map_id integer, basis_id integer, version text NOT NULL, PRIMARY KEY (map_id, basis_id)
    )
    """,
)
_LACKS_INDEX = "SELECT to_regclass('photo_vector_hnsw') IS NULL AND EXISTS (SELECT FROM photo_vector)"
_MAKE_INDEX = (
    "CREATE INDEX IF NOT EXISTS photo_vector_hnsw ON photo_vector USING hnsw (vector halfvec_ip_ops)",
    "ANALYZE photo_vector",
)
_STALE = """
SELECT record.map_id, record.basis_id FROM map_vectors record
LEFT JOIN searchable_map USING (map_id, basis_id)
WHERE record.version IS DISTINCT FROM searchable_map.version ORDER BY 1, 2
"""
_TIDY = """
WITH gone AS (
    DELETE FROM searchable_map had WHERE NOT EXISTS (
        SELECT FROM map_vectors record WHERE (record.map_id, record.basis_id) = (had.map_id, had.basis_id)
    ) RETURNING map_id, basis_id
)
DELETE FROM photo_vector USING gone
WHERE (photo_vector.map_id, photo_vector.basis_id) = (gone.map_id, gone.basis_id)
"""
_RECORD = text("""
SELECT record.version, record.contents, record.vectors FROM map_vectors record
LEFT JOIN searchable_map USING (map_id, basis_id)
WHERE record.map_id = :map AND record.basis_id = :basis
    AND record.version IS DISTINCT FROM searchable_map.version
""")
_COPY = "COPY photo_vector (map_id, basis_id, content, vector) FROM STDIN (FORMAT binary)"
_COPY_BEGIN, _COPY_END = b"PGCOPY\n\xff\r\n\0" + bytes(8), b"\xff\xff"
_COUNT = text("""
SELECT map_id, photos FROM map_vectors JOIN searchable_map USING (map_id, basis_id)
WHERE basis_id = :basis AND map_id = ANY(:maps)
""")
_BY_INDEX = text("""
SELECT map_id, -(vector <#> CAST(:query AS halfvec)) FROM photo_vector
WHERE basis_id = :basis AND map_id = ANY(:maps)
ORDER BY vector <#> CAST(:query AS halfvec) LIMIT :nearest
""")
_ALL = text("""
SELECT map_id, avg(likeness) FROM (
    SELECT map_id, likeness, row_number() OVER (PARTITION BY map_id ORDER BY likeness DESC) AS place FROM (
        SELECT map_id, -(vector <#> CAST(:query AS halfvec)) AS likeness FROM photo_vector
        WHERE basis_id = :basis AND map_id = ANY(:maps)
    ) AS photo
) AS ranked WHERE place <= :compared GROUP BY map_id
""")


class PhotoSearch:
    """The vectors of photos in the database.

    It raises errors of SQLAlchemy: see `Database.translated_errors`.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._said = False

    def stale(self) -> list[tuple[int, int]] | None:
        """List the maps and bases whose vectors are missing or outdated; None if there are no tables."""
        with self._engine.connect() as connection:
            if not self._is_there(connection):
                return None
            return [(int(map_id), int(basis_id)) for map_id, basis_id in connection.exec_driver_sql(_STALE)]

    def is_behind(self) -> bool:
        """Return whether `refresh` has something to do; False if the server lacks the extension."""
        if self._said:
            return False
        with self._engine.connect() as connection:
            if self._is_there(connection):
                return connection.exec_driver_sql(_STALE).first() is not None
            can = connection.exec_driver_sql(_CAN).scalar_one()
            return bool(can) and connection.exec_driver_sql(_ANY).first() is not None

    def refresh(self, *, check: Callable[[], None] = lambda: None) -> None:
        """Update the rows after changes of the records, committing map by map so that no work is repeated.

        If the server lacks the extension, this does nothing, and logs that once.

        Args:
            check: Called before each map; may raise to stop, and the rest is done the next time.
        """
        if not self._prepare():
            return
        for map_id, basis_id in self.stale() or ():
            check()
            with self._engine.begin() as connection:
                _refresh_map(connection, map_id, basis_id)
        with self._engine.begin() as connection:
            connection.exec_driver_sql(_UNLIMITED)
            connection.exec_driver_sql(_TIDY)
            if connection.exec_driver_sql(_LACKS_INDEX).scalar_one():
                for statement in _MAKE_INDEX:  # built after the first rows are there, which is much faster
                    connection.exec_driver_sql(statement)

    def likeness(
        self, query: NDArray[np.float32], *, basis_id: int, map_ids: Collection[int]
    ) -> dict[int, float]:
        """Compare a photo with those of maps.

        Args:
            query: (128,) float32. A unit vector.
            map_ids: Maps that the user may see: only their photos are compared.

        Returns:
            Mean cosine similarity of the most similar photos of each map. If there are too many photos, only
                maps that the index finds likely are compared; others have estimates below -1, in the order of
                their photos found by the index. Maps without rows are left out.
        """
        values = {
            "query": f"[{','.join(map(repr, query.tolist()))}]",
            "basis": basis_id,
            "maps": list(map_ids),
        }
        with self._engine.begin() as connection:
            if not self._is_there(connection):
                return {}
            photos = {int(id): int(n) for id, n in connection.execute(_COUNT, values)}
            values["maps"] = [*photos]
            found = dict.fromkeys(photos, -1.0)
            wanted = min(NEAREST, sum(photos.values()))
            if sum(photos.values()) > _FEW:
                nearest = _nearest(connection, {**values, "nearest": wanted})
                if len(nearest) >= wanted:
                    found = _by_nearest(nearest, photos)
                    values["maps"] = _likely(found, photos)
            means = connection.execute(_ALL, {**values, "compared": COMPARED}).all()
        return found | {int(id): float(mean) for id, mean in means}

    @staticmethod
    def _is_there(connection: Connection) -> bool:
        return bool(connection.exec_driver_sql(_IS_THERE).scalar_one())

    def _prepare(self) -> bool:
        """Create the tables if the server has the extension; return whether it has."""
        try:
            with self._engine.begin() as connection:
                connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK}, 0)")
                connection.exec_driver_sql(_ADD_EXTENSION)
                version = str(connection.exec_driver_sql(_VERSION).scalar_one())
                if tuple(map(int, version.split(".")[:2])) < _OLDEST:
                    self._say(f"pgvector is {version}, and 0.8 or newer is needed")
                    return False
                for statement in _MAKE:
                    connection.exec_driver_sql(statement)
        except DBAPIError as error:
            if getattr(error.orig, "sqlstate", None) not in _NO_EXTENSION:
                raise
            self._say(str(error.orig).partition("\n")[0])
            return False
        return True

    def _say(self, reason: str) -> None:
        if not self._said:
            _log.info("similar photos are not searched for in the database, but in memory: %s", reason)
            self._said = True


def _refresh_map(connection: Connection, map_id: int, basis_id: int) -> None:
    """Add the rows of new photos, and delete those of photos that are gone."""
    connection.exec_driver_sql(_UNLIMITED)  # a large map takes minutes
    connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK}, {map_id})")
    key = {"map": map_id, "basis": basis_id}
    record = connection.execute(_RECORD, key).one_or_none()
    if record is None:  # deleted, or refreshed by another worker meanwhile
        return
    where = "WHERE map_id = :map AND basis_id = :basis"
    rows = connection.execute(text(f"SELECT content FROM photo_vector {where}"), key)
    before = {bytes(content) for (content,) in rows}
    starts = range(0, len(record.contents), _SHA256_BYTES)
    numbers = {bytes(record.contents[s : s + _SHA256_BYTES]): number for number, s in enumerate(starts)}
    gone = [*before - numbers.keys()]
    connection.execute(
        text(f"DELETE FROM photo_vector {where} AND content = ANY(:gone)"), {**key, "gone": gone}
    )
    new = [(content, number) for content, number in numbers.items() if content not in before]
    _copy(connection, _binary_rows(new, record.vectors, map_id=map_id, basis_id=basis_id))
    connection.execute(
        text(
            "INSERT INTO searchable_map VALUES (:map, :basis, :version) "
            "ON CONFLICT (map_id, basis_id) DO UPDATE SET version = excluded.version"
        ),
        {**key, "version": record.version},
    )


def _binary_rows(new: Iterable[tuple[bytes, int]], vectors: bytes, *, map_id: int, basis_id: int) -> bytes:
    """Encode rows for `COPY`: each value after its length, all big-endian."""
    import numpy as np

    values = np.frombuffer(vectors, "<f2").reshape(-1, _DIMENSIONS)
    chosen = [*new]
    rows = np.zeros(
        len(chosen),
        [
            ("values", ">i2"),
            ("map_bytes", ">i4"),
            ("map", ">i4"),
            ("basis_bytes", ">i4"),
            ("basis", ">i4"),
            ("content_bytes", ">i4"),
            ("content", "u1", _SHA256_BYTES),
            ("vector_bytes", ">i4"),
            ("dimensions", ">i2"),
            ("unused", ">i2"),
            ("vector", ">f2", _DIMENSIONS),
        ],
    )
    rows["values"], rows["map_bytes"], rows["basis_bytes"] = 4, 4, 4
    rows["map"], rows["basis"] = map_id, basis_id
    rows["content_bytes"], rows["vector_bytes"] = _SHA256_BYTES, 4 + 2 * _DIMENSIONS
    rows["dimensions"] = _DIMENSIONS
    if chosen:
        rows["content"] = np.array([np.frombuffer(content, np.uint8) for content, _ in chosen])
        rows["vector"] = values[[number for _, number in chosen]]
    return rows.tobytes()


def _copy(connection: Connection, rows: bytes) -> None:
    driver: Any = connection.connection.driver_connection
    dialect = connection.dialect
    try:
        with driver.cursor() as cursor, cursor.copy(_COPY) as copy:
            copy.write(_COPY_BEGIN + rows + _COPY_END)
    except dialect.loaded_dbapi.Error as error:  # raised by the driver itself: wrap it like SQLAlchemy
        raise DBAPIError.instance(_COPY, None, error, dialect.loaded_dbapi.Error, dialect=dialect) from error


def _nearest(connection: Connection, values: Mapping[str, Any]) -> list[tuple[int, float]]:
    """Query the index for the most similar photos: the ids of their maps, and their similarity."""
    connection.exec_driver_sql("SET LOCAL hnsw.iterative_scan = relaxed_order")
    connection.exec_driver_sql(f"SET LOCAL hnsw.ef_search = {NEAREST}")
    return [(int(id), float(likeness)) for id, likeness in connection.execute(_BY_INDEX, values)]


def _by_nearest(nearest: list[tuple[int, float]], photos: Mapping[int, int]) -> dict[int, float]:
    """Estimate the likeness of maps from the most similar photos of all maps, shifted below -1."""
    each: dict[int, list[float]] = {}
    for id, likeness in nearest:
        each.setdefault(id, []).append(likeness)
    farthest = min(likeness for _, likeness in nearest)
    found = dict.fromkeys(photos, _NOT_COMPARED - 1.0)
    for id, some in each.items():
        # Its photos that were not found are at most as similar as the last one found.
        best = sorted(some, reverse=True)[:COMPARED] + [farthest] * (min(COMPARED, photos[id]) - len(some))
        found[id] = sum(best) / len(best) + _NOT_COMPARED
    return found


def _likely(found: Mapping[int, float], photos: Mapping[int, int]) -> list[int]:
    """List the most likely maps, as many as can be compared photo by photo."""
    ordered = sorted(found, key=found.__getitem__, reverse=True)
    sums = itertools.accumulate(photos[id] for id in ordered)
    return [id for id, total in zip(ordered, sums, strict=True) if total <= _FEW] or ordered[:1]
