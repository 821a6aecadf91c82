"""Passkeys of accounts: public keys of authenticators, by the ids of their credentials."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import BigInteger, ForeignKey, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from webapp.core import texts
from webapp.errors import Conflict, NotFound, UsageError
from webapp.store.clock import now
from webapp.store.schema import IDS_USED_ONCE, Account, Base

MOST = 20
"""Maximum number of passkeys of an account."""

_MAX_NAME = 60


class Passkey(Base):
    """A passkey; its private key is in the authenticator only."""

    __tablename__ = "passkey"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), index=True)
    name: Mapped[str]
    credential: Mapped[str] = mapped_column(unique=True)
    """Id of the credential, in base64url."""
    public_key: Mapped[str]
    """COSE key, in base64url."""
    uses: Mapped[int] = mapped_column(BigInteger)
    """As the authenticator counts them; 0 if it does not."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    used_at: Mapped[datetime | None]


def of_account(session: Session, account_id: int) -> list[Passkey]:
    """List the passkeys of an account, the oldest first."""
    mine = select(Passkey).where(Passkey.account_id == account_id)
    return list(session.scalars(mine.order_by(Passkey.id)))


def by_credential(session: Session, credential: str) -> tuple[Passkey, Account] | None:
    """Find a passkey and its account by the id of the credential; None if it is unknown."""
    found = select(Passkey, Account).join(Account).where(Passkey.credential == credential)
    row = session.execute(found).first()
    return None if row is None else (row[0], row[1])


def add(session: Session, passkey: Passkey) -> None:
    """Add a passkey. Raises Conflict, UsageError."""
    if by_credential(session, passkey.credential) is not None:
        raise Conflict("this passkey is there already", hint="sign in with it")
    if len(of_account(session, passkey.account_id)) >= MOST:
        raise UsageError(f"an account has at most {MOST} passkeys", hint="remove one first")
    session.add(passkey)


def checked_name(name: str) -> str:
    """Return the name of a passkey as it is stored. Raises UsageError."""
    tidy = texts.tidy_name(name, most=_MAX_NAME)
    if tidy is None:
        raise UsageError("this is not a valid name", hint=f"give 1 to {_MAX_NAME} printable characters")
    return tidy


def find(session: Session, account_id: int, *, id: int) -> Passkey:
    """Find a passkey of an account. Raises NotFound."""
    passkey = session.get(Passkey, id)
    if passkey is None or passkey.account_id != account_id:
        raise NotFound("passkey not found", hint="reload the page")
    return passkey
