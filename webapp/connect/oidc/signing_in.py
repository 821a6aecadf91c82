"""From a person whom the provider has signed in to an account, and what its session keeps."""

from __future__ import annotations

import base64
import logging
from pathlib import Path

from sqlalchemy.orm import Session

from webapp.errors import NotAllowed
from webapp.extras import extra
from webapp.settings import OidcSettings
from webapp.store.accounts import identities
from webapp.store.accounts.identities import Person, SignInIdentity
from webapp.store.accounts.secret_key import derived_secret
from webapp.store.schema import Account

_PURPOSE = "id tokens of sign-ins"

_log = logging.getLogger(__name__)


def admit(
    session: Session, person: Person, *, settings: OidcSettings
) -> tuple[Account | None, SignInIdentity]:
    """Find or make the account of a person, and give it the roles of the person's groups.

    An identity without an account is kept, for the owners of the library to link: the caller commits before
    it refuses.

    Returns:
        The account, None if the person may not sign in; and the identity.
    """
    identity = identities.note(session, person)
    listed = identities.has_rule(session, person.groups)
    if identity.account_id is None and settings.match_email == "verified" and person.email_verified:
        found = identities.account_with_mail(session, person.email or "", issuer=person.issuer)
        if found is not None:
            identities.link(session, identity, account=found)
            _log.info("%s at the provider is %s, by the e-mail address", identity.id, found.name)
    if settings.accounts == "groups" and not listed:
        if identity.account_id is not None:
            identities.apply_groups(session, identity, groups=())
        return None, identity
    if identity.account_id is None and settings.accounts != "linked":
        identities.new_account(session, identity)
    if identity.account_id is None:
        return None, identity
    identities.apply_groups(session, identity, groups=person.groups)
    return session.get_one(Account, identity.account_id), identity


def not_admitted(settings: OidcSettings, identity: SignInIdentity) -> NotAllowed:
    if settings.accounts == "groups":
        return NotAllowed(
            "you are in none of the groups that may sign in here", hint="ask the owner of the library"
        )
    return NotAllowed(
        "you have no account here yet", hint="the owner of the library can link it now: ask for it"
    )


def encrypted(inner: Path, id_token: str) -> str:
    """Encrypt an ID token for the database.

    Args:
        inner: The library's folder with its key.
    """
    with extra("connect"):
        from cryptography.fernet import Fernet
    return Fernet(_key(inner)).encrypt(id_token.encode()).decode("ascii")


def decrypted(inner: Path, stored: str) -> str | None:
    """Decrypt an ID token; None if the library has another key since."""
    with extra("connect"):
        from cryptography.fernet import Fernet, InvalidToken
    try:
        return Fernet(_key(inner)).decrypt(stored.encode("ascii")).decode()
    except InvalidToken:
        return None


def _key(inner: Path) -> bytes:
    return base64.urlsafe_b64encode(derived_secret(inner, _PURPOSE))
