"""An OpenID Connect provider, written from the specifications: it signs in whoever it is set to, at once."""

import base64
import hashlib
import json
import secrets
import threading
import time
from contextlib import contextmanager
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, parse_qsl, urlencode, urlsplit

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import padding, rsa

CLIENT, SECRET = "maps", "s3cret of the maps"


def b64(data):
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


@cache
def key(number):
    return rsa.generate_private_key(65537, 2048)


def number_text(value):
    return b64(value.to_bytes((value.bit_length() + 7) // 8, "big"))


def signed(claims, *, by, kid, alg="RS256"):
    """Make a JWT (RFC 7515, RFC 7519)."""
    header = {"alg": alg, "typ": "JWT", "kid": kid}
    text = ".".join(b64(json.dumps(part).encode()) for part in (header, claims))
    if alg == "none":
        return f"{text}."
    return f"{text}.{b64(key(by).sign(text.encode(), padding.PKCS1v15(), hashes.SHA256()))}"


class Provider:
    """What it answers, and what it was asked; tests change both."""

    def __init__(self):
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self.issuer = f"http://127.0.0.1:{self.server.server_port}"
        self.clear()

    def clear(self):
        self.user = {"sub": "u-17", "name": "Jana", "email": "jana@example.org", "email_verified": True}
        self.claims, self.userinfo, self.answers, self.metadata = {}, {}, {}, {}
        self.denies, self.key, self.kid, self.alg = None, 0, "first", "RS256"
        self.asked, self.codes, self.outs = [], {}, []

    def discovery(self):
        return {
            "issuer": self.issuer,
            "authorization_endpoint": f"{self.issuer}/authorize",
            "token_endpoint": f"{self.issuer}/token",
            "jwks_uri": f"{self.issuer}/keys",
            "userinfo_endpoint": f"{self.issuer}/userinfo",
            "end_session_endpoint": f"{self.issuer}/out",
            "id_token_signing_alg_values_supported": ["RS256", "HS256"],
            "token_endpoint_auth_methods_supported": ["client_secret_basic"],
            **self.metadata,
        }

    def keys(self):
        numbers = key(self.key).public_key().public_numbers()
        made = {"kty": "RSA", "use": "sig", "alg": "RS256", "kid": self.kid}
        return {"keys": [{**made, "n": number_text(numbers.n), "e": number_text(numbers.e)}]}

    def authorize(self, query):
        """Return where the browser goes on."""
        assert query["response_type"] == "code" and query["client_id"] == CLIENT
        assert "openid" in query["scope"].split() and query["code_challenge_method"] == "S256"
        back = {"state": query["state"], "iss": self.issuer}
        if self.denies:
            back |= {"error": self.denies}
        else:
            back["code"] = secrets.token_urlsafe(8)
            self.codes[back["code"]] = query
        return f"{query['redirect_uri']}?{urlencode(back)}"

    def token(self, form, authorization):
        asked = self.codes.pop(form.get("code"), None)
        by = base64.b64decode(authorization.removeprefix("Basic ")).decode()
        challenge = b64(hashlib.sha256(form["code_verifier"].encode()).digest())
        if asked is None or form["redirect_uri"] != asked["redirect_uri"]:
            return 400, {"error": "invalid_grant"}
        if by != f"{CLIENT}:{SECRET}" or challenge != asked["code_challenge"]:
            return 401, {"error": "invalid_client"}
        now = int(time.time())
        claims = {"iss": self.issuer, "aud": CLIENT, "iat": now, "exp": now + 300, "nonce": asked["nonce"]}
        claims = {name: value for name, value in {**claims, **self.user, **self.claims}.items() if value}
        made = signed(claims, by=self.key, kid=self.kid, alg=self.alg)
        return 200, {"access_token": "at", "token_type": "Bearer", "expires_in": 60, "id_token": made}


def _handler(provider):
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            parts = urlsplit(self.path)
            query = dict(parse_qsl(parts.query))
            provider.asked.append(parts.path)
            if parts.path == "/authorize":
                self._send(303, b"", Location=provider.authorize(query))
            elif parts.path == "/out":
                provider.outs.append(query)
                self._send(303, b"", Location=query["post_logout_redirect_uri"])
            else:
                made = {
                    "/.well-known/openid-configuration": provider.discovery,
                    "/keys": provider.keys,
                    "/userinfo": lambda: {"sub": provider.user["sub"], **provider.userinfo},
                }[parts.path]
                self._json(parts.path, 200, made())

        def do_POST(self):
            provider.asked.append(self.path)
            form = parse_qs(self.rfile.read(int(self.headers["Content-Length"])).decode())
            flat = {name: value[0] for name, value in form.items()}
            self._json(self.path, *provider.token(flat, self.headers.get("Authorization", "")))

        def _json(self, path, status, content):
            status, body = provider.answers.get(path, (status, json.dumps(content).encode()))
            self._send(status, body, **{"Content-Type": "application/json"})

        def _send(self, status, body, **headers):
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    return Handler


@contextmanager
def serving():
    provider = Provider()
    thread = threading.Thread(target=provider.server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield provider
    finally:
        provider.server.shutdown()
        provider.server.server_close()
        thread.join()
