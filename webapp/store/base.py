"""What all tables have in common."""

from __future__ import annotations

from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import JSON, ForeignKey, MetaData
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from webapp.store.clock import UtcDateTime, now


class Base(DeclarativeBase):
    """Every table; constraints have names, so that a migration can change them."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(column_0_N_label)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[dict[Any, Any]] = {
        dict[str, Any]: JSON,
        list[dict[str, Any]]: JSON,
        datetime: UtcDateTime,
    }


class ShareColumns:
    """What every kind of share has: a view of something that is open without a sign-in.

    Each kind is a table with a foreign key to what it shows. So a share goes with what it shows, whoever
    deletes that: a database may give the id of a deleted map to a new one, which nobody has shared.
    """

    id: Mapped[int] = mapped_column(primary_key=True)
    token_hash: Mapped[str] = mapped_column(unique=True)
    public_token: Mapped[str | None]
    """The end of the address, of a share that is listed for everybody; of a secret one nothing is kept."""
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    """Who made it."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    photos: Mapped[bool] = mapped_column(default=False)
    """Whether previews of photos are shown."""
