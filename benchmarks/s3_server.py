"""An S3 server of `moto` in a separate process, with latency, limited bandwidth, and simulated outages."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

BUCKET = "maps"
_BLOCK = 1 << 18
_CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}


class ObjectServer:
    """Serves one bucket from memory, until the end of the context.

    Parameters
    ----------
    mb_s : float
        Bandwidth of all connections together, MB/s.
    ms : float
        Latency of each response, milliseconds.

    Attributes:
    ----------
    environ : dict of str to str
        Environment variables with which programs reach it.
    """

    def __init__(self, mb_s: float, ms: float) -> None:
        code = f"from benchmarks.s3_server import serve; serve({mb_s}, {ms})"
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self._process.stdout is not None
        self.environ = {**_CREDENTIALS, "AWS_ENDPOINT_URL": self._process.stdout.readline().strip()}

    def __enter__(self) -> ObjectServer:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    def be_silent(self, seconds: float) -> None:
        """Stop responding for a while, without closing connections."""
        self._process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._process.send_signal(signal.SIGCONT)


def serve(mb_s: float, ms: float) -> None:
    """Serve one bucket, and print the address; never returns."""
    import boto3
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    whole = DomainDispatcherApplication(create_backend_app)
    server = make_server("127.0.0.1", 0, _Throttled(whole, mb_s * 1e6, ms / 1e3), threaded=True)
    address = f"http://127.0.0.1:{server.server_port}"
    serving = threading.Thread(target=server.serve_forever)
    serving.start()
    boto3.client(
        "s3",
        endpoint_url=address,
        aws_access_key_id="test",
        aws_secret_access_key="test",
        region_name="us-east-1",
    ).create_bucket(Bucket=BUCKET)
    print(address, flush=True)
    serving.join()


class _Throttled:
    """WSGI middleware that adds latency, and limits the bandwidth."""

    def __init__(self, application: Any, bytes_per_s: float, wait_s: float) -> None:
        self._application, self._bytes_per_s, self._wait_s = application, bytes_per_s, wait_s
        self._lock, self._free_at = threading.Lock(), 0.0

    def __call__(self, environ: dict[str, Any], start: Callable[..., Any]) -> Iterator[bytes]:
        """Handle a WSGI request."""
        time.sleep(self._wait_s)
        return self._slowly(self._application(environ, start))

    def _slowly(self, pieces: Iterable[bytes]) -> Iterator[bytes]:
        for piece in pieces:
            for begin in range(0, len(piece), _BLOCK):
                block = piece[begin : begin + _BLOCK]
                with self._lock:
                    now = time.monotonic()
                    self._free_at = max(now, self._free_at) + len(block) / self._bytes_per_s
                    wait = self._free_at - now
                time.sleep(wait)
                yield block
