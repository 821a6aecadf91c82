"""Downloads one file of known size."""

from __future__ import annotations

import requests

from webapp import __version__
from webapp.errors import InputError
from webapp.progress import Progress

_USER_AGENT = f"experience-map/{__version__}"
_TIMEOUT_S = 20.0
_CHUNK = 65_536
_HINT = "try again later, or copy the file to this machine yourself and give its folder with --from"


def download(address: str, *, size: int, progress: Progress) -> bytes:
    """Fetch a file.

    Parameters
    ----------
    size : int
        Expected size in bytes; reading stops beyond it.
    progress : Progress
        One step per 2^16 bytes.

    Returns
    -------
    bytes
        Of the right size; the caller has to check the content.

    Raises
    ------
    InputError
        The host does not answer, or not with a file of this size.
    Cancelled
    """
    progress.size(-(-size // _CHUNK))
    data = bytearray()
    try:
        # no redirects: they could lead to a host that the user has not agreed to
        with requests.get(
            address,
            headers={"User-Agent": _USER_AGENT},
            timeout=_TIMEOUT_S,
            stream=True,
            allow_redirects=False,
        ) as answer:
            if answer.status_code != requests.codes.ok:
                raise InputError(f"the host answered {answer.status_code}", where=address, hint=_HINT)
            for chunk in answer.iter_content(_CHUNK):
                progress.check()
                data += chunk
                progress.advance()
                if len(data) > size:
                    break
    except requests.RequestException as error:
        message = f"the host cannot be reached ({type(error).__name__})"
        raise InputError(message, where=address, hint=_HINT) from error
    if len(data) != size:
        received = "more" if len(data) > size else len(data)
        raise InputError(f"expected {size} bytes, received {received}", where=address, hint=_HINT)
    return bytes(data)
