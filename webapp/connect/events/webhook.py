"""Webhooks as in the specification Standard Webhooks: JSON, signed by HMAC-SHA256 over id, time and body."""

from __future__ import annotations

import base64
import hmac
import json
import time
from collections.abc import Mapping
from typing import Any

import requests
from urllib3.util import parse_url

from webapp import __version__
from webapp.errors import InputError, UsageError
from webapp.net.bounded import bounded
from webapp.net.public_hosts import public_session
from webapp.settings import EventSettings

_USER_AGENT = f"experience-map/{__version__} (webhooks)"
_MAX_ADDRESS = 1000
_MAX_ANSWER_BYTES = 100_000
_PREFIX = "whsec_"


def check_address(address: str) -> str:
    """Return the address of a webhook as it is stored. Raises UsageError."""
    given = address.strip()
    hint = "write it like https://example.org/hook, without user and password"
    plain = given.isascii() and given.isprintable() and not {" ", "\\"} & set(given)
    try:
        parts = parse_url(given) if plain and len(given) <= _MAX_ADDRESS else None
    except ValueError:
        parts = None
    if parts is None or parts.scheme not in ("http", "https") or not parts.host or parts.auth is not None:
        raise UsageError("this is not the address of a webhook", hint=hint)
    return given


def secret_text(secret: bytes) -> str:
    """Return a secret in the form in which receivers get it."""
    return _PREFIX + base64.b64encode(secret).decode()


def signed_headers(id: str, body: bytes, *, secret: bytes, at_s: int) -> dict[str, str]:
    signature = hmac.digest(secret, f"{id}.{at_s}.".encode() + body, "sha256")
    return {
        "webhook-id": id,
        "webhook-timestamp": str(at_s),
        "webhook-signature": f"v1,{base64.b64encode(signature).decode()}",
    }


def post(address: str, content: Mapping[str, Any], *, secret: bytes, settings: EventSettings) -> None:
    """Send an event, whose `id` becomes that of the message.

    Redirects are not followed. The body of the answer is not read.

    Raises:
        InputError: It was not accepted; the message says why.
    """
    body = json.dumps(content, ensure_ascii=False).encode()
    headers = {
        "Content-Type": "application/json",
        **signed_headers(content["id"], body, secret=secret, at_s=int(time.time())),
    }
    try:
        with (
            bounded(_MAX_ANSWER_BYTES),
            public_session(_USER_AGENT, allowed=settings.private_hosts) as session,
            session.post(
                address,
                data=body,
                headers=headers,
                timeout=settings.timeout_s,
                stream=True,
                allow_redirects=False,
            ) as answer,
        ):
            status = answer.status_code
    except (requests.RequestException, OSError, ValueError) as error:
        raise InputError(f"the receiver cannot be reached ({_reason(error)})") from error
    if 300 <= status < 400:
        raise InputError(
            f"the receiver redirects ({status}), which is not followed", hint="give the final address"
        )
    if not 200 <= status < 300:
        raise InputError(f"the receiver answered {status}")


def _reason(error: BaseException) -> str:
    """Name the innermost error: those around it have the whole address in their texts."""
    while (inner := error.__cause__ or error.__context__) is not None:
        error = inner
    return type(error).__name__
