"""Passkeys (WebAuthn): people sign in with the lock of their phone or computer, or with a security key."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.passkeys.command:passkeys_command",
    "List or remove the passkeys of an account.",
    "webapp.connect.passkeys.pages:PARTS",
)
