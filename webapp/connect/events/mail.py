"""E-mail by SMTP, through the server of the settings."""

from __future__ import annotations

import smtplib
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from email.errors import HeaderParseError
from email.headerregistry import Address
from email.message import EmailMessage
from email.policy import SMTP
from email.utils import formatdate, make_msgid
from typing import Any

from webapp.errors import InputError, NotReady, UsageError
from webapp.settings import MailSettings

_PORTS = {"starttls": 587, "tls": 465, "none": 25}
_MAX_ADDRESS = 254
_TOTAL = 4.0
"""Time for a whole message, in timeouts: that of a socket is only the one of a single read."""


def check_address(address: str) -> str:
    """Return an e-mail address as it is stored. Raises UsageError."""
    given = address.strip()
    try:
        found = Address(addr_spec=given) if given.isascii() and given.isprintable() else None
    except (ValueError, IndexError, HeaderParseError):
        found = None
    if found is None or "." not in found.domain or found.addr_spec != given or len(given) > _MAX_ADDRESS:
        raise UsageError("this is not an e-mail address", hint="write it like name@example.org")
    return given


def is_set_up(settings: MailSettings) -> bool:
    return settings.host is not None and settings.sender is not None


def compose(
    settings: MailSettings, to: str, *, subject: str, text: str, id: str | None = None
) -> EmailMessage:
    """Make a message.

    Args:
        id: Of the event; all tries have the same Message-ID, by which mail programs recognise a repeated one.
    """
    sender = settings.sender or ""
    domain = sender.rpartition("@")[2].rstrip(">") or "localhost"
    message = EmailMessage(policy=SMTP)
    message["From"], message["To"] = sender, to
    message["Subject"] = " ".join(subject.split())
    message["Date"] = formatdate()
    message["Message-ID"] = f"<{id}@{domain}>" if id else make_msgid(domain=domain)
    message["Auto-Submitted"] = "auto-generated"
    message.set_content(text)
    return message


def send(settings: MailSettings, message: EmailMessage, *, timeout_s: float) -> None:
    """Send a message.

    Raises:
        NotReady: There is no mail server in the settings.
        UsageError: The settings are wrong.
        InputError: The server does not accept it; the message says why.
    """
    try:
        with _signed_in(settings, timeout_s) as server:
            server.send_message(message)
    except smtplib.SMTPAuthenticationError as error:
        raise InputError(f"the mail server refuses user or password{_said(error.smtp_code)}") from error
    except smtplib.SMTPRecipientsRefused as error:
        code = next((code for code, _ in error.recipients.values()), None)
        raise InputError(f"the mail server refuses the address{_said(code)}") from error
    except (smtplib.SMTPConnectError, smtplib.SMTPHeloError) as error:
        raise InputError(f"the mail server refuses the connection{_said(error.smtp_code)}") from error
    except smtplib.SMTPResponseException as error:
        raise InputError(f"the mail server refuses the message{_said(error.smtp_code)}") from error
    except smtplib.SMTPNotSupportedError as error:
        raise InputError(f"the mail server cannot do this: {error}", hint="see mail.security") from error
    except (smtplib.SMTPException, OSError, ValueError) as error:
        raise InputError(f"the mail server cannot be reached ({type(error).__name__})") from error


def _said(code: int | None) -> str:
    return "" if code is None or code < 0 else f" ({code})"


@contextmanager
def _signed_in(settings: MailSettings, timeout_s: float) -> Iterator[smtplib.SMTP]:
    if settings.host is None or settings.sender is None:
        raise NotReady(
            "this server sends no e-mail", hint="its operator sets mail.host and mail.sender: docs/events.md"
        )
    security = settings.security
    if security not in _PORTS:
        raise UsageError(
            f"{security!r} is not allowed", where="mail.security", hint=f"write one of {', '.join(_PORTS)}"
        )
    port, context = settings.port or _PORTS[security], ssl.create_default_context()
    server: smtplib.SMTP
    if security == "tls":
        server = _SecureServer(settings.host, port, timeout=timeout_s, context=context)
    else:
        server = _Server(settings.host, port, timeout=timeout_s)
    try:
        if security == "starttls":
            server.starttls(context=context)
        if settings.user is not None:
            server.login(settings.user, settings.password or "")
        yield server
        with suppress(smtplib.SMTPException, OSError):
            server.quit()  # the message is accepted, whatever the server says now
    finally:
        server.close()


class _WithDeadline:
    """Ends a connection after a total time, which a server that sends a byte now and then would exceed."""

    sock: socket.socket | None
    timeout: float
    _deadline: threading.Timer | None = None

    def connect(self, *args: Any, **options: Any) -> tuple[int, bytes]:
        self._deadline = threading.Timer(_TOTAL * self.timeout, self._cut)
        self._deadline.daemon = True
        self._deadline.start()
        answer: tuple[int, bytes] = super().connect(*args, **options)  # type: ignore[misc]
        return answer

    def close(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        super().close()  # type: ignore[misc]

    def _cut(self) -> None:
        sock = self.sock
        if sock is not None:
            with suppress(OSError):
                socket.socket.shutdown(sock, socket.SHUT_RDWR)


class _Server(_WithDeadline, smtplib.SMTP):
    pass


class _SecureServer(_WithDeadline, smtplib.SMTP_SSL):
    pass
