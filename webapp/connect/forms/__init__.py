"""Field forms: exports of ODK, KoboToolbox and QField become photos of a map, with positions and notes."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.forms.command:forms",
    "Show the photos, positions and notes of an export of ODK, KoboToolbox or QField.",
    "webapp.connect.forms.pages:PARTS",
    "webapp.connect.forms.kinds:JOBS",
)
