"""One-time codes of an app as the second factor of a password (TOTP, RFC 6238), and codes for recovery.

The secret of an account is derived from the library's key and a salt, so that no database and no backup has
it. Recovery codes are random, and only their hashes are stored.
"""

from __future__ import annotations

import base64
import hmac
import secrets
import struct
import time
from datetime import datetime
from pathlib import Path
from urllib.parse import quote, urlencode

from sqlalchemy import ForeignKey, delete, func, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from webapp.errors import Conflict, NotReady, NotSignedIn
from webapp.store.accounts import accounts
from webapp.store.accounts.secret_key import derived_secret
from webapp.store.clock import now
from webapp.store.schema import WITHOUT_ROWID, Account, Base

STEP_S, DIGITS = 30, 6
"""What every app supports: the defaults of RFC 6238."""

_BYTES = 20
_DRIFT = 1
"""Steps by which the clock of a phone may be wrong."""

_RECOVERY_CODES = 10
_RECOVERY_BYTES = 10
_ISSUER = "Experience Map"


class OneTimeCodes(Base):
    """The app of an account, confirmed or being set up."""

    __tablename__ = "one_time_codes"
    __table_args__ = WITHOUT_ROWID

    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), primary_key=True)
    salt: Mapped[str]
    """What the secret is derived from, with the library's key; it is no secret itself."""
    confirmed_at: Mapped[datetime | None]
    """None: no code of the app was entered yet, so that none is asked for."""
    last_step: Mapped[int] = mapped_column(default=0)
    """Of the last accepted code: no code is accepted twice."""


class RecoveryCode(Base):
    """A code for one sign-in without the app; only its hash is stored."""

    __tablename__ = "recovery_code"
    __table_args__ = WITHOUT_ROWID

    code_hash: Mapped[str] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), index=True)


def of_account(session: Session, account_id: int) -> OneTimeCodes | None:
    """Return the app of an account, also one that is being set up."""
    return session.get(OneTimeCodes, account_id)


def are_asked_for(session: Session, account_id: int) -> bool:
    """Return whether a password alone does not sign in."""
    found = session.get(OneTimeCodes, account_id)
    return found is not None and found.confirmed_at is not None


def recovery_codes_left(session: Session, account_id: int) -> int:
    return session.scalars(
        select(func.count()).select_from(RecoveryCode).where(RecoveryCode.account_id == account_id)
    ).one()


def begin(session: Session, account: Account) -> OneTimeCodes:
    """Begin to set up an app, with a new secret. Raises Conflict if there is one."""
    if are_asked_for(session, account.id):
        raise Conflict("one-time codes are set up already", hint="turn them off first")
    return session.merge(OneTimeCodes(account_id=account.id, salt=secrets.token_hex(16), last_step=0))


def secret_of(inner: Path, codes: OneTimeCodes) -> str:
    """Return the secret that the app gets, in base32.

    Args:
        inner: The library's folder with its key.
    """
    return base64.b32encode(_key(inner, codes)).decode()


def app_address(secret: str, *, name: str) -> str:
    """Return what the QR code says to the app."""
    query = {"secret": secret, "issuer": _ISSUER, "algorithm": "SHA1", "digits": DIGITS, "period": STEP_S}
    return f"otpauth://totp/{quote(_ISSUER)}:{quote(name, safe='')}?{urlencode(query, quote_via=quote)}"


def confirm(session: Session, inner: Path, *, account_id: int, code: str) -> list[str]:
    """Turn one-time codes on by the first code of the app; returns new recovery codes.

    Raises:
        NotReady: Nobody has begun to set them up.
        NotSignedIn: The code is wrong.
    """
    codes = session.get(OneTimeCodes, account_id, with_for_update=True)
    if codes is None:
        raise NotReady("one-time codes are not being set up", hint="begin again")
    _use(inner, codes, code=code)
    codes.confirmed_at = codes.confirmed_at or now()
    return new_recovery_codes(session, account_id)


def use(session: Session, inner: Path, *, account_id: int, code: str) -> None:
    """Use a code of the app or a recovery code up. Raises NotSignedIn if it is wrong or was used."""
    codes = session.get(OneTimeCodes, account_id, with_for_update=True)
    if codes is None or codes.confirmed_at is None:
        raise NotReady("one-time codes are not set up", hint="reload the page")
    if len(_plain(code)) > DIGITS:
        row = session.get(RecoveryCode, accounts.hashed(_plain(code)), with_for_update=True)
        if row is None or row.account_id != account_id:
            raise _wrong()
        session.delete(row)
    else:
        _use(inner, codes, code=code)


def new_recovery_codes(session: Session, account_id: int) -> list[str]:
    """Replace the recovery codes of an account; they are returned only here."""
    session.execute(delete(RecoveryCode).where(RecoveryCode.account_id == account_id))
    made = [
        base64.b32encode(secrets.token_bytes(_RECOVERY_BYTES)).decode().lower()
        for _number in range(_RECOVERY_CODES)
    ]
    session.add_all(RecoveryCode(code_hash=accounts.hashed(code), account_id=account_id) for code in made)
    return ["-".join(code[i : i + 4] for i in range(0, len(code), 4)) for code in made]


def turn_off(session: Session, account_id: int) -> None:
    """Have passwords sign in alone again."""
    session.execute(delete(RecoveryCode).where(RecoveryCode.account_id == account_id))
    session.execute(delete(OneTimeCodes).where(OneTimeCodes.account_id == account_id))


def _use(inner: Path, codes: OneTimeCodes, *, code: str) -> None:
    current = int(time.time()) // STEP_S
    for step in range(current - _DRIFT, current + _DRIFT + 1):
        right = hmac.compare_digest(_code(_key(inner, codes), step).encode(), _plain(code).encode())
        if right and step > codes.last_step:
            codes.last_step = step
            return
    raise _wrong()


def _wrong() -> NotSignedIn:
    return NotSignedIn(
        "this code is wrong or was used already", hint="wait for the next one, or enter a recovery code"
    )


def _code(key: bytes, step: int) -> str:
    """Compute the code of a step (RFC 4226, section 5.3)."""
    digest = hmac.digest(key, struct.pack(">Q", step), "sha1")
    offset = digest[-1] & 0xF
    number = int.from_bytes(digest[offset : offset + 4], "big") & 0x7FFF_FFFF
    return str(number % 10**DIGITS).zfill(DIGITS)


def _plain(code: str) -> str:
    return "".join(code.replace("-", " ").split()).lower()[:100]


def _key(inner: Path, codes: OneTimeCodes) -> bytes:
    return derived_secret(inner, f"one-time codes {codes.account_id} {codes.salt}")[:_BYTES]
