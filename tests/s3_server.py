"""An S3 server for tests (`moto`) behind a proxy that can be slow or silent, refuse, or break connections."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from uuid import uuid4

import boto3
from moto.server import ThreadedMotoServer

from webapp.files import contents
from webapp.files.object_storage.storage import ObjectStorage

CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}

_PASSED_ON = ("content-type", "content-length", "etag", "last-modified", "content-range", "accept-ranges")
_BLOCK = 1 << 16


@contextmanager
def using(storage: ObjectStorage | None) -> Iterator[None]:
    """Use a storage in the block."""
    before = contents.in_use()
    contents.use(storage)
    try:
        yield
    finally:
        contents.use(before)


class S3Server:
    """A server with a proxy, whose address the program gets.

    Attributes
    ----------
    refuse : tuple of int and str, or None
        Status and S3 code of the responses to all requests.
    refused_methods : set of str
        Methods to which `refuse` is limited.
    silent : threading.Event
        While set, no request gets a response.
    bytes_per_s : float or None
        Rate of each response.
    cut : dict of str to int
        Bytes after which the connection is closed, by method: of the response to GET, of the body of PUT.
    requests : list of str
        Methods and paths, in order.
    """

    def __init__(self):
        self._server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        self._server.start()
        self.host, self.port = self._server.get_host_and_port()
        self.reset()
        self.silent = threading.Event()
        proxy = self
        self._proxy = _Proxy(("127.0.0.1", 0), type("Handler", (_Handler,), {"proxy": proxy}))
        self._proxy.daemon_threads = True
        threading.Thread(target=self._proxy.serve_forever, args=(0.05,), daemon=True).start()
        self.address = f"http://127.0.0.1:{self._proxy.server_address[1]}"
        self.client = boto3.client(
            "s3",
            endpoint_url=f"http://{self.host}:{self.port}",
            aws_access_key_id="test",
            aws_secret_access_key="test",
            region_name="us-east-1",
        )

    def reset(self):
        """Work as a proper S3 server again."""
        self.refuse, self.refused_methods, self.bytes_per_s = (
            None,
            {"GET", "PUT", "POST", "HEAD", "DELETE"},
            None,
        )
        self.requests, self.cut = [], {}

    def new_bucket(self):
        """Make a bucket and return its name."""
        name = f"photos-{uuid4().hex[:12]}"
        self.client.create_bucket(Bucket=name)
        return name

    def keys(self, bucket):
        """List the objects in a bucket."""
        return [one["Key"] for one in self.client.list_objects_v2(Bucket=bucket).get("Contents", ())]

    def stop(self):
        """Stop server and proxy."""
        self.client.close()
        self._proxy.shutdown()
        self._proxy.server_close()
        self._server.stop()


class _Proxy(ThreadingHTTPServer):
    def handle_error(self, *_):
        """Ignore clients that close the connection after their timeout."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def _answer(self):
        length = int(self.headers.get("Content-Length") or 0)
        cut = self.proxy.cut.get(self.command, length + 1) if self.command == "PUT" else length + 1
        body = self.rfile.read(min(length, cut))
        self.proxy.requests.append(f"{self.command} {self.path}")
        if cut < length:
            self._break_off()
            return
        while self.proxy.silent.is_set():
            time.sleep(0.02)
        if self.proxy.refuse is not None and self.command in self.proxy.refused_methods:
            self._refuse(*self.proxy.refuse)
            return
        headers = {name: value for name, value in self.headers.items() if name.lower() != "expect"}
        with closing(HTTPConnection(self.proxy.host, self.proxy.port, timeout=30)) as there:
            there.request(self.command, self.path, body, headers)
            answer = there.getresponse()
            content = answer.read()
        self.send_response(answer.status)
        for name, value in answer.getheaders():
            if name.lower() in _PASSED_ON and not (
                name.lower() == "content-length" and self.command != "HEAD"
            ):
                self.send_header(name, value)
        if self.command != "HEAD":
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        cut = self.proxy.cut.get(self.command, len(content))
        if cut < len(content):
            self.wfile.write(content[:cut])
            self._break_off()
            return
        for start in range(0, len(content), _BLOCK):
            self.wfile.write(content[start : start + _BLOCK])
            if self.proxy.bytes_per_s:
                time.sleep(len(content[start : start + _BLOCK]) / self.proxy.bytes_per_s)

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _answer  # noqa: N815 - as the base class has them

    def _break_off(self):
        self.close_connection = True
        self.wfile.flush()
        self.connection.shutdown(socket.SHUT_RDWR)

    def _refuse(self, status, code):
        content = f"<Error><Code>{code}</Code><Message>no</Message></Error>".encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/xml")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, *_):
        """Log nothing."""
