"""A server for the robot's client that follows the protocol, and misbehaves on request.

As a program, `python stand_in.py PORT FILE`, it stores its data in a file, which survives a kill.
"""

import json
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

Reply = tuple[int, dict, dict]


class StandIn:
    """Stores batches of each sender in order, exactly once; `script` may respond instead."""

    def __init__(self, file: Path | None = None, port: int = 0) -> None:
        self.records: dict[str, list[dict]] = {}
        self.photos: dict[str, dict] = {}
        self.requests: list[tuple[str, dict]] = []
        self.script: Callable[[str, dict], Reply | None] = lambda path, body: None
        self._file = file
        self._guard = threading.Lock()
        if file is not None and file.exists():
            for line in file.read_text().splitlines():
                self._keep(json.loads(line))
        self.http = ThreadingHTTPServer(("127.0.0.1", port), _handler(self))
        self.http.daemon_threads = True

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.http.server_address[1]}"

    def stored(self) -> list[dict]:
        """Return the records of the only sender."""
        (records,) = self.records.values()
        return records

    def __enter__(self) -> "StandIn":
        threading.Thread(target=self.http.serve_forever, args=(0.01,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.http.shutdown()
        self.http.server_close()

    def reply(self, path: str, body: dict) -> Reply:
        self.requests.append((path, body))
        reply = self.script(path, body)
        if reply is not None:
            return reply
        return self.store(body)

    def store(self, body: dict) -> Reply:
        """Store a batch as a server does, and return the response."""
        with self._guard:
            return self._batch(body)

    def _batch(self, body: dict) -> Reply:
        have = self.records.setdefault(body["sender"], [])
        first, count = body["first"], len(body["records"])
        if first > len(have):
            return refused(409, where="first", next=len(have))
        for place, record in enumerate(body["records"]):
            if record.get("class") == "bad":
                return refused(422, where=f"records.{place}.class")
        already = min(len(have) - first, count)
        new = {"sender": body["sender"], "records": body["records"][already:]}
        if self._file is not None and new["records"]:
            with self._file.open("ab", buffering=0) as file:
                file.write(json.dumps(new).encode() + b"\n")
        self._keep(new)
        return 200, {"next": len(have), "stored": count - already, "already": already, "revision": 1}, {}

    def _keep(self, new: dict) -> None:
        self.records.setdefault(new["sender"], []).extend(new["records"])


def refused(status: int, *, where: str = "", headers: dict | None = None, **more: object) -> Reply:
    """Return an error in the form of the API."""
    error = {"code": "x", "message": f"status {status}", "hint": None, "where": where, **more}
    return status, {"error": error}, headers or {}


def _handler(server: StandIn) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            data = self.rfile.read(int(self.headers["Content-Length"]))
            is_json = self.headers["Content-Type"] == "application/json"
            body = json.loads(data) if is_json else {"form": data, "type": self.headers["Content-Type"]}
            body["token"] = self.headers["Authorization"]
            status, reply, headers = server.reply(self.path, body)
            if status == 0:
                self.close_connection = True
                return
            text = json.dumps(reply).encode()
            self.send_response(status)
            for name, value in {**headers, "Content-Length": str(len(text))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_: object) -> None:
            pass

    return Handler


if __name__ == "__main__":
    StandIn(Path(sys.argv[2]), int(sys.argv[1])).http.serve_forever(0.01)
