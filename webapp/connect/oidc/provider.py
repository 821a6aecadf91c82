"""The provider: its metadata and keys, the authorization code flow with PKCE, and the checks of ID tokens.

By OpenID Connect Core 1.0, Discovery 1.0, RP-Initiated Logout 1.0, RFC 7636 and RFC 9207.
"""

from __future__ import annotations

import ipaddress
import json
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import urlencode, urlsplit

import requests

from webapp import __version__
from webapp.errors import InputError, NotReady, NotSignedIn, UsageError
from webapp.extras import extra
from webapp.net.bounded import BoundedAdapter, answering, body, bounded, bounded_session
from webapp.settings import OidcSettings
from webapp.store.accounts.identities import Person

if TYPE_CHECKING:
    from authlib.integrations.requests_client import OAuth2Session

_PATH = "/.well-known/openid-configuration"
_USER_AGENT = f"experience-map/{__version__} (sign-in)"
_MAX_BYTES = 1_000_000
_MAX_TEXT = 255
_MOST_GROUPS = 1000
_KEPT_S = 3600.0
"""How long metadata and keys are used before they are read again."""

_DEAD_S = 3.0
"""How long a provider that did not answer is not asked again."""

_MOST_UNKNOWN = 100
_LEEWAY_S = 60
"""Difference of clocks that is forgiven."""

_ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Signatures by keys of the provider: neither `none`, nor one that somebody with our secret could make."""

_CHECKED_LATER = "try again; if it stays, the operator checks the provider: expmap connect oidc"


def check_settings(settings: OidcSettings) -> None:
    """Check what can be checked without the provider. Raises UsageError."""
    if settings.issuer is None:
        if settings.required == "yes":
            raise UsageError(
                "sign-in by a provider is required, but there is none",
                where="oidc.required",
                hint="set oidc.issuer and oidc.client_id",
            )
        return
    if not _is_allowed(settings.issuer, settings.issuer) or urlsplit(settings.issuer).query:
        raise UsageError(
            f"{settings.issuer!r} is not the address of a provider",
            where="oidc.issuer",
            hint="write it like https://id.example.org; http:// is for this machine alone",
        )
    if settings.client_id is None:
        raise UsageError("this is missing", where="oidc.client_id", hint="the provider has it")
    if "openid" not in settings.scopes.split():
        raise UsageError("openid is missing", where="oidc.scopes", hint="write it like openid profile email")


def is_set_up(settings: OidcSettings) -> bool:
    return settings.issuer is not None


def shown_name(settings: OidcSettings) -> str:
    return settings.name or urlsplit(settings.issuer or "").hostname or ""


@dataclass(frozen=True, slots=True)
class Metadata:
    """What a provider says about itself."""

    authorization: str
    token: str
    keys: str
    userinfo: str | None
    end_session: str | None
    by_secret: str  # How this server authenticates to the token endpoint
    algorithms: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Attempt:
    """What a browser keeps while somebody signs in at the provider."""

    state: str
    nonce: str
    verifier: str


class Provider:
    """A provider, whose metadata and keys are kept for an hour; for several threads."""

    def __init__(self, settings: OidcSettings) -> None:
        self.settings = settings
        self.issuer = settings.issuer or ""
        self._turn = threading.Lock()
        self._metadata: tuple[Metadata, float] | None = None
        self._keys: tuple[dict[str, Any], float] | None = None
        self._failed: tuple[InputError | NotReady, float] | None = None
        self._unknown: set[str] = set()  # Ids of keys that the provider did not have either

    def metadata(self) -> Metadata:
        """Read the metadata. Raises InputError, NotReady."""
        with self._turn:
            if self._failed is not None and time.monotonic() < self._failed[1]:
                raise self._failed[0]
            if self._metadata is None or self._metadata[1] < time.monotonic():
                address = self.issuer.rstrip("/") + _PATH
                try:
                    found = self._understood(self._get(address), where=address)
                except (InputError, NotReady) as error:  # so that requests do not queue up behind a dead one
                    self._failed = (error, time.monotonic() + _DEAD_S)
                    raise
                self._metadata = (found, time.monotonic() + _KEPT_S)
            return self._metadata[0]

    def keys(self, *, again: bool = False) -> dict[str, Any]:
        """Read the keys that sign ID tokens. Raises InputError, NotReady."""
        address = self.metadata().keys
        with self._turn:
            if again or self._keys is None or self._keys[1] < time.monotonic():
                found = self._get(address)
                if not isinstance(found.get("keys"), list) or not found["keys"]:
                    raise InputError("the provider sends no keys", where=address, hint=_CHECKED_LATER)
                self._keys = (found, time.monotonic() + _KEPT_S)
            return self._keys[0]

    def authorization(self, attempt: Attempt, *, redirect: str) -> str:
        """Return the address where somebody signs in. Raises InputError, NotReady, MissingPart."""
        with self._client() as client:
            address, _ = client.create_authorization_url(
                self.metadata().authorization,
                state=attempt.state,
                nonce=attempt.nonce,
                code_verifier=attempt.verifier,
                redirect_uri=redirect,
            )
        return str(address)

    def person(self, code: str, attempt: Attempt, *, redirect: str) -> tuple[Person, str]:
        """Exchange a code for a person, verified, and the ID token.

        Raises:
            NotSignedIn: The provider refuses the code, or the ID token is not valid.
            InputError, NotReady: The provider cannot be understood, or reached.
        """
        tokens = self._exchange(code, attempt, redirect=redirect)
        claims = self._verified(tokens["id_token"], attempt, access_token=tokens.get("access_token"))
        claims = {**self._userinfo(tokens, subject=claims["sub"]), **claims}
        return self._described(claims), tokens["id_token"]

    def end_session(self, id_token: str, *, back: str) -> str | None:
        """Return the address where a session ends; None if the provider has none."""
        address = self.metadata().end_session
        if address is None:
            return None
        query = {
            "id_token_hint": id_token,
            "client_id": self.settings.client_id or "",
            "post_logout_redirect_uri": back,
        }
        return f"{address}{'&' if urlsplit(address).query else '?'}{urlencode(query)}"

    def _understood(self, found: Mapping[str, Any], *, where: str) -> Metadata:
        if found.get("issuer") != self.issuer:
            raise InputError(
                f"the provider calls itself {str(found.get('issuer'))[:200]!r}",
                where=where,
                hint="set oidc.issuer to exactly this, if it is the right one",
            )
        ways = found.get("token_endpoint_auth_methods_supported") or ["client_secret_basic"]
        offered = found.get("id_token_signing_alg_values_supported") or ["RS256"]
        algorithms = tuple(name for name in _ALGORITHMS if name in offered)
        if not algorithms:
            raise InputError(f"the provider signs by none of {', '.join(_ALGORITHMS)}", where=where)
        by_secret = "client_secret_basic" if "client_secret_basic" in ways else "client_secret_post"
        needed, optional = partial(self._address, found, where), partial(self._optional, found, where)
        return Metadata(
            authorization=needed("authorization_endpoint"),
            token=needed("token_endpoint"),
            keys=needed("jwks_uri"),
            userinfo=optional("userinfo_endpoint"),
            end_session=optional("end_session_endpoint"),
            by_secret=by_secret if self.settings.client_secret else "none",
            algorithms=algorithms,
        )

    def _optional(self, found: Mapping[str, Any], where: str, name: str) -> str | None:
        return self._address(found, where, name) if found.get(name) else None

    def _address(self, found: Mapping[str, Any], where: str, name: str) -> str:
        address = found.get(name)
        if not isinstance(address, str) or not _is_allowed(address, self.issuer):
            raise InputError(f"the provider names no usable {name}", where=where, hint=_CHECKED_LATER)
        return address

    def _get(self, address: str, *, token: str | None = None) -> dict[str, Any]:
        """Read a JSON object of the provider."""
        headers = {"Accept": "application/json", "Accept-Encoding": "identity"}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        with (
            _translated(address),
            bounded_session(_USER_AGENT) as session,
            answering(
                session,
                address,
                most_bytes=_MAX_BYTES,
                timeout_s=self.settings.timeout_s,
                headers=headers,
            ) as answer,
        ):
            if answer.status_code != requests.codes.ok:
                message = f"the provider answered {answer.status_code}"
                raise NotReady(message, where=address, hint=_CHECKED_LATER)
            found = json.loads(body(answer, most_bytes=_MAX_BYTES) or b"")
            if not isinstance(found, dict):
                raise ValueError("no object")
            return found

    @contextmanager
    def _client(self) -> Iterator[OAuth2Session]:
        with extra("connect"):
            from authlib.integrations.requests_client import OAuth2Session
        metadata = self.metadata()
        with (
            bounded(_MAX_BYTES),
            OAuth2Session(
                self.settings.client_id,
                self.settings.client_secret,
                token_endpoint_auth_method=metadata.by_secret,
                scope=self.settings.scopes,
                code_challenge_method="S256",
            ) as client,
        ):
            for scheme in ("https://", "http://"):
                client.mount(scheme, BoundedAdapter())
            client.headers.update({"User-Agent": _USER_AGENT, "Accept-Encoding": "identity"})
            yield client

    def _exchange(self, code: str, attempt: Attempt, *, redirect: str) -> dict[str, Any]:
        address = self.metadata().token
        with self._client() as client, _translated(address):
            with extra("connect"):
                from authlib.integrations.base_client import OAuthError

            try:
                tokens = client.fetch_token(
                    address,
                    code=code,
                    redirect_uri=redirect,
                    code_verifier=attempt.verifier,
                    timeout=self.settings.timeout_s,
                    allow_redirects=False,
                )
            except OAuthError as error:
                raise NotSignedIn(
                    f"the provider refuses: {_short(error.error)}", hint="sign in again"
                ) from error
        if not isinstance(tokens.get("id_token"), str):
            raise InputError("the provider sends no ID token", where=address, hint=_CHECKED_LATER)
        return dict(tokens)

    def _verified(self, id_token: str, attempt: Attempt, *, access_token: object) -> dict[str, Any]:
        """Check an ID token: signature, issuer, audience, time, nonce and hash of the access token."""
        with extra("connect"):
            from authlib.oidc.core import CodeIDToken
            from joserfc.errors import JoseError

        try:
            decoded = self._decoded(id_token)
            claims = CodeIDToken(
                decoded.claims,
                decoded.header,
                {
                    "iss": {"essential": True, "value": self.issuer},
                    "aud": {"essential": True, "value": self.settings.client_id or ""},
                    "nonce": {"essential": True, "value": attempt.nonce},
                },
                {"nonce": attempt.nonce, "client_id": self.settings.client_id, "access_token": access_token},
            )
            claims.validate(leeway=_LEEWAY_S)
            if not isinstance(claims["sub"], str) or not 0 < len(claims["sub"]) <= _MAX_TEXT:
                raise ValueError("sub")
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise NotSignedIn(
                f"the ID token of the provider is not valid ({_short(error)})", hint="sign in again"
            ) from error
        return dict(claims)

    def _decoded(self, id_token: str) -> Any:
        with extra("connect"):
            from joserfc import jwt
            from joserfc.errors import BadSignatureError, InvalidKeyIdError
            from joserfc.jwk import KeySet
            from joserfc.jws import JWSRegistry

        rules = JWSRegistry(algorithms=list(self.metadata().algorithms), strict_check_header=False)
        try:
            return jwt.decode(id_token, KeySet.import_key_set(cast(Any, self.keys())), registry=rules)
        except (InvalidKeyIdError, BadSignatureError):
            name = _key_id(id_token)
            if name in self._unknown or len(self._unknown) >= _MOST_UNKNOWN:
                raise
        # The provider has changed its keys: they are read again, once for each id that is not among them.
        self._unknown.add(name)
        decoded = jwt.decode(
            id_token, KeySet.import_key_set(cast(Any, self.keys(again=True))), registry=rules
        )
        self._unknown.discard(name)
        return decoded

    def _userinfo(self, tokens: Mapping[str, Any], *, subject: str) -> dict[str, Any]:
        """Read what some providers keep out of ID tokens, such as groups."""
        address, token = self.metadata().userinfo, tokens.get("access_token")
        if address is None or not isinstance(token, str):
            return {}
        found = self._get(address, token=token)
        if found.get("sub") != subject:
            raise NotSignedIn("the provider describes somebody else", hint="sign in again")
        return found

    def _described(self, claims: Mapping[str, Any]) -> Person:
        groups = claims.get(self.settings.groups_claim)
        given = [groups] if isinstance(groups, str) else groups if isinstance(groups, list) else []
        mail = claims.get("email")
        names = (claims.get(key) for key in ("name", "preferred_username", "email"))
        name = next((one for one in names if isinstance(one, str) and one.strip()), claims["sub"])
        return Person(
            issuer=self.issuer,
            subject=claims["sub"],
            name=name,
            email=mail if isinstance(mail, str) and mail else None,
            email_verified=claims.get("email_verified") is True,
            groups=tuple(one for one in given if isinstance(one, str))[:_MOST_GROUPS],
        )


@contextmanager
def _translated(address: str) -> Iterator[None]:
    """Turn the errors of a request into sentences, without what was sent."""
    try:
        yield
    except (json.JSONDecodeError, UnicodeDecodeError, requests.exceptions.ContentDecodingError) as error:
        raise InputError(
            "the provider's answer cannot be understood", where=address, hint=_CHECKED_LATER
        ) from error
    except (requests.RequestException, OSError) as error:
        raise NotReady(
            f"the provider cannot be reached ({type(error).__name__})", where=address, hint=_CHECKED_LATER
        ) from error
    except ValueError as error:
        raise InputError(
            "the provider's answer cannot be understood", where=address, hint=_CHECKED_LATER
        ) from error


def _is_allowed(address: str, issuer: str) -> bool:
    """Return whether an address is encrypted, or on this machine as the issuer is."""
    try:
        parts, home = urlsplit(address), urlsplit(issuer)
        if not parts.hostname or parts.username or parts.fragment or not address.isprintable():
            return False
        return parts.scheme == "https" or (
            parts.scheme == home.scheme == "http" and _is_local(parts.hostname) and _is_local(home.hostname)
        )
    except ValueError:
        return False


def _is_local(host: str | None) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False


def _key_id(id_token: str) -> str:
    with extra("connect"):
        from joserfc.jws import extract_compact

    return str(extract_compact(id_token.encode()).protected.get("kid"))[:_MAX_TEXT]


def _short(error: object) -> str:
    text = " ".join(str(error).split())
    return text[:100] if text.isprintable() and text else type(error).__name__
