"""Where the messages of long-running commands go."""

from __future__ import annotations

import logging


def log_to_stderr() -> None:
    """Write the program's own messages, and warnings of libraries, to standard error."""
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.WARNING)
    logging.getLogger("webapp").setLevel(logging.INFO)
