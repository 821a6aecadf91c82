"""Photo libraries: albums of Immich and PhotoPrism on maps, and positions back into them."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.libraries.command:libraries",
    "Try the address and the API key of a photo library.",
    "webapp.connect.libraries.pages:PARTS",
    "webapp.connect.libraries.due:JOBS",
)
