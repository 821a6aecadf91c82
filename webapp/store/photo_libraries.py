"""Photo libraries that accounts connect, and the albums that maps have of them.

The originals stay in the library; a connection updates the albums (`webapp/connect/libraries/`).
"""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import ForeignKey, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from webapp.store.clock import now
from webapp.store.schema import IDS_USED_ONCE, WITHOUT_ROWID, Base

HERE = "here"
"""State of a photo that the album has."""

KEPT, TAKEN = "kept", "taken"
"""States of a photo that the album no longer has: the map keeps it, or it was removed from the map, too."""


class PhotoLibrary(Base):
    """A photo library of an account."""

    __tablename__ = "photo_library"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), index=True)
    kind: Mapped[str]
    """`immich` or `photoprism`."""
    address: Mapped[str]
    sealed_key: Mapped[str]
    """The API key, encrypted with the library's key."""
    created_at: Mapped[datetime] = mapped_column(default=now)


class LinkedAlbum(Base):
    """An album of a photo library, whose photos are on a map."""

    __tablename__ = "linked_album"
    __table_args__ = (UniqueConstraint("library_id", "album", "map_id"), IDS_USED_ONCE)

    id: Mapped[int] = mapped_column(primary_key=True)
    library_id: Mapped[int] = mapped_column(ForeignKey("photo_library.id", ondelete="CASCADE"))
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), index=True)
    album: Mapped[str]
    """Its id in the photo library."""
    name: Mapped[str]
    every_h: Mapped[int]
    """Hours between two updates; 0: only on request."""
    writes_back: Mapped[bool]
    """Whether positions that people set here are written into the photo library."""
    due_at: Mapped[datetime | None]
    """Time of the next update; by the clock of the database."""
    updated_at: Mapped[datetime | None]
    """End of the last complete update."""
    error: Mapped[str | None]
    """Why the last update failed, as a sentence."""


class LinkedPhoto(Base):
    """A photo of a linked album."""

    __tablename__ = "linked_photo"
    __table_args__ = WITHOUT_ROWID

    album_id: Mapped[int] = mapped_column(ForeignKey("linked_album.id", ondelete="CASCADE"), primary_key=True)
    asset: Mapped[str] = mapped_column(primary_key=True)
    """Its id in the photo library."""
    checksum: Mapped[str]
    """Of the original."""
    photo_id: Mapped[int | None]
    """The photo of the map; None if the file could not be used."""
    lat: Mapped[float | None]
    """Position in the photo library when it was last read or written."""
    lon: Mapped[float | None]
    written: Mapped[bool] = mapped_column(default=False)
    """Whether that position was written from here."""
    sent_lat: Mapped[float | None]
    """Position that was about to be written: the update that did so may have been killed before or after."""
    sent_lon: Mapped[float | None]
    state: Mapped[str] = mapped_column(default=HERE)
    problem: Mapped[str | None]
    """Why its file could not be used, as a sentence."""
