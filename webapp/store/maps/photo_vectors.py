"""Vectors of photos, map by map, and the bases (VLAD codebook, principal axes) by which they are computed.

Searches use one basis; while it is being replaced, there is a new one, too, by which not all maps are
described yet.
"""

from __future__ import annotations

import io
import secrets
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ForeignKey, delete, func, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from webapp.core.retrieval.engines.vlad import Codebook
from webapp.core.retrieval.global_descriptors import DIMENSIONS, Basis
from webapp.store.schema import Base, MapRecord

_SHA256_BYTES = 32
_FLOAT16 = np.dtype("<f2")


class VectorBasis(Base):
    __tablename__ = "vector_basis"

    id: Mapped[int] = mapped_column(primary_key=True)
    photos: Mapped[int]
    """Number of photos of the library when it was trained."""
    ready: Mapped[bool] = mapped_column(default=False)
    """Whether the photos of all maps are described by it."""
    arrays: Mapped[bytes]


class MapVectors(Base):
    __tablename__ = "map_vectors"

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    basis_id: Mapped[int] = mapped_column(ForeignKey("vector_basis.id", ondelete="CASCADE"), primary_key=True)
    version: Mapped[str]
    """Changes whenever the vectors change."""
    photos: Mapped[int]
    contents: Mapped[bytes]
    """SHA-256 of the photos, 32 bytes each."""
    vectors: Mapped[bytes]
    """float16, in the same order."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredBasis:
    id: int
    photos: int  # Number of photos of the library when it was trained
    ready: bool  # Whether the photos of all maps are described by it
    basis: Basis


def bases(session: Session) -> list[StoredBasis]:
    """List the bases, the oldest first."""
    rows = session.scalars(select(VectorBasis).order_by(VectorBasis.id))
    return [StoredBasis(row.id, row.photos, row.ready, _basis(row.arrays)) for row in rows]


def ready_basis(session: Session, *, known: StoredBasis | None = None) -> StoredBasis | None:
    """Return the basis that searches use: `known` itself if that has not changed."""
    id = session.scalar(
        select(VectorBasis.id).where(VectorBasis.ready).order_by(VectorBasis.id.desc()).limit(1)
    )
    if id is None or (known is not None and known.id == id):
        return None if id is None else known
    row = session.get_one(VectorBasis, id)
    return StoredBasis(row.id, row.photos, row.ready, _basis(row.arrays))


def add_basis(session: Session, basis: Basis, *, photos: int) -> int:
    """Store a new basis, by which no map is described yet; return its id."""
    file = io.BytesIO()
    codebook = basis.codebook
    np.savez(file, centres=codebook.centres, mean=codebook.mean, axes=basis.axes.astype(_FLOAT16))
    row = VectorBasis(photos=photos, arrays=file.getvalue())
    session.add(row)
    session.flush()
    return row.id


def use_basis(session: Session, id: int) -> None:
    """Let searches use a basis, and delete the others with their vectors.

    Does nothing if the basis is gone, because another worker was faster with its own.
    """
    row = session.get(VectorBasis, id)
    if row is not None:
        session.execute(delete(VectorBasis).where(VectorBasis.id != id))
        row.ready = True


def vectors(session: Session, map_id: int, *, basis_id: int) -> dict[str, NDArray[np.float16]]:
    """Return the vectors of a map's photos by hexadecimal SHA-256."""
    row = session.get(MapVectors, (map_id, basis_id))
    if row is None:
        return {}
    keys = (row.contents[i : i + _SHA256_BYTES].hex() for i in range(0, len(row.contents), _SHA256_BYTES))
    return dict(zip(keys, _vectors(row.vectors), strict=True))


def keep_vectors(
    session: Session, map_id: int, *, basis_id: int, vectors: Mapping[str, NDArray[np.float16]]
) -> None:
    """Replace the vectors of a map's photos; does nothing if the map or the basis is gone."""
    if session.get(MapRecord, map_id) is None or session.get(VectorBasis, basis_id) is None:
        return
    rows = np.array(list(vectors.values()), _FLOAT16).reshape(-1, DIMENSIONS)
    session.merge(
        MapVectors(
            map_id=map_id,
            basis_id=basis_id,
            version=secrets.token_hex(8),
            photos=len(rows),
            contents=b"".join(bytes.fromhex(content) for content in vectors),
            vectors=rows.tobytes(),
        )
    )


def versions(session: Session, *, basis_id: int) -> dict[int, str]:
    rows = session.execute(
        select(MapVectors.map_id, MapVectors.version).where(MapVectors.basis_id == basis_id)
    )
    return {id: str(version) for id, version in rows}


def matrices(
    session: Session, map_ids: Collection[int], *, basis_id: int
) -> dict[int, tuple[str, NDArray[np.float16]]]:
    """Return versions and (n, `DIMENSIONS`) vectors of some maps, by map id."""
    rows = session.execute(
        select(MapVectors.map_id, MapVectors.version, MapVectors.vectors).where(
            MapVectors.basis_id == basis_id, MapVectors.map_id.in_(map_ids)
        )
    )
    return {id: (version, _vectors(data)) for id, version, data in rows}


def count_described(session: Session, *, basis_id: int) -> int:
    total = select(func.coalesce(func.sum(MapVectors.photos), 0)).where(MapVectors.basis_id == basis_id)
    return int(session.scalar(total) or 0)


def _basis(data: bytes) -> Basis:
    arrays = np.load(io.BytesIO(data), allow_pickle=False)
    return Basis(Codebook(arrays["centres"], arrays["mean"]), arrays["axes"].astype(np.float32))


def _vectors(data: bytes) -> NDArray[np.float16]:
    return np.frombuffer(data, _FLOAT16).reshape(-1, DIMENSIONS)
