"""Events: webhooks and e-mail when a robot is silent, a job fails, or something is shared."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.events.command:events",
    "Send a test message by the settings for e-mail.",
    "webapp.connect.events.pages:PARTS",
    "webapp.connect.events.due:JOBS",
)
