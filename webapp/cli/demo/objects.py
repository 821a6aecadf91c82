"""An S3 server for `expmap cluster demo`, from the package `moto`; it keeps its objects in memory.

python -m webapp.cli.demo.objects
"""

from __future__ import annotations

import signal
import threading

import click

from webapp.extras import extra


def main() -> None:
    """Serve until SIGTERM; prints the address once it listens."""
    with extra("demo"):
        import flask_cors  # noqa: F401  (moto's server needs it)
        from moto.server import ThreadedMotoServer
    stopped = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    click.echo(f"listening on http://{host}:{port}")
    stopped.wait()
    server.stop()


if __name__ == "__main__":
    main()
