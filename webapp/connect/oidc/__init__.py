"""OpenID Connect: people sign in at a provider, whose groups give roles."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.oidc.command:oidc",
    "Check the OpenID Connect provider of the settings.",
    "webapp.connect.oidc.pages:PARTS",
)
