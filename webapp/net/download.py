"""Downloads one file of known size."""

from __future__ import annotations

import requests

from webapp import __version__
from webapp.errors import InputError
from webapp.net.bounded import CHUNK, answering, body, bounded_session
from webapp.progress import Progress

_USER_AGENT = f"experience-map/{__version__}"
_TIMEOUT_S = 20.0
_HINT = "try again later, or copy the file to this machine yourself and give its folder with --from"


def download(address: str, *, size: int, progress: Progress) -> bytes:
    """Fetch a file.

    Args:
        size: Expected size in bytes; reading stops beyond it.
        progress: One step per 2^16 bytes.

    Returns:
        Of the right size; the caller has to check the content.

    Raises:
        InputError: The host does not answer, or not with a file of this size.
        Cancelled
    """
    progress.size(-(-size // CHUNK))

    def advance() -> None:
        progress.check()
        progress.advance()

    try:
        with (
            bounded_session(_USER_AGENT) as session,
            answering(session, address, most_bytes=size, timeout_s=_TIMEOUT_S) as answer,
        ):
            if answer.status_code != requests.codes.ok:
                raise InputError(f"the host answered {answer.status_code}", where=address, hint=_HINT)
            data = body(answer, most_bytes=size, at_chunk=advance)
    except requests.RequestException as error:
        message = f"the host cannot be reached ({type(error).__name__})"
        raise InputError(message, where=address, hint=_HINT) from error
    if data is None or len(data) != size:
        received = "more" if data is None else len(data)
        raise InputError(f"expected {size} bytes, received {received}", where=address, hint=_HINT)
    return data
