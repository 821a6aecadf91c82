"""The two ceremonies of WebAuthn, Level 3: registering a passkey, and signing in with one."""

from __future__ import annotations

import base64
import ipaddress
import json
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from webapp.errors import InputError, NotSignedIn
from webapp.extras import extra
from webapp.store.accounts.passkeys import Passkey
from webapp.store.schema import Account

_MAX_CHARACTERS = 50_000
_TIMEOUT_MS = 300_000


@dataclass(frozen=True, slots=True)
class PasskeySite:
    """The address to which passkeys belong."""

    origin: str

    @property
    def host(self) -> str:
        return urlsplit(self.origin).hostname or ""

    @property
    def has_passkeys(self) -> bool:
        """Whether browsers offer passkeys there: at a name, by https or on this machine."""
        try:
            ipaddress.ip_address(self.host)
        except ValueError:
            return self.origin.startswith("https://") or self.host == "localhost"
        return False


def registration_options(
    site: PasskeySite, account: Account, *, handle: bytes, known: list[Passkey]
) -> dict[str, Any]:
    """Make the options of `navigator.credentials.create`.

    Args:
        handle: Random id of the account, by which an authenticator replaces an older passkey.
        known: Those that the account has: the same authenticator is not registered twice.
    """
    with extra("connect"):
        import webauthn
        from webauthn.helpers import structs
    options = webauthn.generate_registration_options(
        rp_id=site.host,
        rp_name="Experience Map",
        user_name=account.name,
        user_id=handle,
        timeout=_TIMEOUT_MS,
        authenticator_selection=structs.AuthenticatorSelectionCriteria(
            resident_key=structs.ResidentKeyRequirement.REQUIRED,
            user_verification=structs.UserVerificationRequirement.REQUIRED,
        ),
        exclude_credentials=[
            structs.PublicKeyCredentialDescriptor(id=_bytes(one.credential)) for one in known
        ],
    )
    return _json(options)


def sign_in_options(site: PasskeySite) -> dict[str, Any]:
    """Make the options of `navigator.credentials.get`: the authenticator knows the account."""
    with extra("connect"):
        import webauthn
        from webauthn.helpers import structs
    options = webauthn.generate_authentication_options(
        rp_id=site.host,
        timeout=_TIMEOUT_MS,
        user_verification=structs.UserVerificationRequirement.REQUIRED,
    )
    return _json(options)


def registered(site: PasskeySite, answer: str, *, challenge: str) -> Passkey:
    """Verify the answer of a registration; returns a passkey without account and name. Raises InputError."""
    with extra("connect"):
        import webauthn
        from webauthn.helpers.exceptions import WebAuthnException
    try:
        verified = webauthn.verify_registration_response(
            credential=_read(answer),
            expected_challenge=_bytes(challenge),
            expected_rp_id=site.host,
            expected_origin=site.origin,
            require_user_verification=True,
        )
    except (WebAuthnException, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the passkey cannot be registered ({_short(error)})", hint="try again, or use another device"
        ) from error
    return Passkey(
        credential=_text(verified.credential_id),
        public_key=_text(verified.credential_public_key),
        uses=verified.sign_count,
    )


def credential_of(answer: str) -> str:
    """Return the id of the credential that an answer is about. Raises NotSignedIn."""
    try:
        return _text(_bytes(_read(answer)["rawId"]))
    except (ValueError, KeyError, TypeError) as error:
        raise _refused(error) from error


def used(site: PasskeySite, answer: str, *, challenge: str, passkey: Passkey) -> int:
    """Verify the answer of a sign-in; returns how often the passkey was used. Raises NotSignedIn."""
    with extra("connect"):
        import webauthn
        from webauthn.helpers.exceptions import WebAuthnException
    try:
        verified = webauthn.verify_authentication_response(
            credential=_read(answer),
            expected_challenge=_bytes(challenge),
            expected_rp_id=site.host,
            expected_origin=site.origin,
            credential_public_key=_bytes(passkey.public_key),
            credential_current_sign_count=passkey.uses,
            require_user_verification=True,
        )
    except (WebAuthnException, ValueError, KeyError, TypeError) as error:
        raise _refused(error) from error
    return verified.new_sign_count


def _refused(error: Exception) -> NotSignedIn:
    return NotSignedIn(
        f"the passkey was not accepted ({_short(error)})", hint="try again, or sign in otherwise"
    )


def _read(answer: str) -> dict[str, Any]:
    if len(answer) > _MAX_CHARACTERS:
        raise ValueError("too long")
    found = json.loads(answer)
    if not isinstance(found, dict):
        raise ValueError("no object")
    return found


def _json(options: Any) -> dict[str, Any]:
    with extra("connect"):
        from webauthn import options_to_json

    found: dict[str, Any] = json.loads(options_to_json(options))
    return found


def _text(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode("ascii")


def _bytes(text: object) -> bytes:
    if not isinstance(text, str):
        raise TypeError("no text")
    return base64.b64decode(text.replace("-", "+").replace("_", "/") + "=" * (-len(text) % 4), validate=True)


def _short(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text[:100] if text.isprintable() and text else type(error).__name__
