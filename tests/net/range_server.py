"""A server of one file, which sends parts of it, or answers wrongly."""

import contextlib
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        own, wish = self.server, self.headers["Range"]
        own.asked.append(wish)
        begin, end = (int(part) for part in wish.removeprefix("bytes=").split("-"))
        data = own.content[begin : end + 1]
        if own.mode == "redirect":
            own.mode = "plain"
            return self.answer(302, {"Location": own.target}, b"")
        if own.mode == "whole":
            return self.answer(200, {"ETag": '"1"'}, own.content)
        if own.mode == "missing":
            return self.answer(404, {}, b"no")
        at = f"bytes {begin}-{begin + len(data) - 1}/{len(own.content)}"
        if own.mode == "short":
            data = data[:-1]
        if own.mode == "cut":
            return self.answer(206, {"ETag": own.tag, "Content-Range": at}, data, length=len(data) + 5)
        if own.mode == "elsewhere":
            at = at.replace(f"bytes {begin}", f"bytes {begin + 1}")
        tag = {} if own.mode == "nameless" else {"ETag": own.tag}
        return self.answer(206, {"Content-Range": at, **tag}, data)

    def answer(self, status, headers, data, length=None):
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(length or len(data))}.items():
            self.send_header(name, value)
        self.end_headers()
        with contextlib.suppress(OSError):  # the client has seen enough
            self.wfile.write(data)

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def serving(content):
    """Serve a file; `mode` says how, and `asked` has the ranges that were asked for."""
    own = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    own.mode, own.asked, own.tag, own.content, own.target = "plain", [], '"1"', content, ""
    own.address = f"http://127.0.0.1:{own.server_port}/a.pmtiles?key=secret"
    thread = threading.Thread(target=own.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield own
    finally:
        own.shutdown()
        own.server_close()
        thread.join()
