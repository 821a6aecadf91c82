"""E-mail: what arrives, that an address is confirmed first, and what mail servers do to it."""

import re
import shutil
import socket
import ssl
import subprocess
import threading
import time
from dataclasses import replace
from email import message_from_bytes
from email.policy import default

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult
from click.testing import CliRunner

from tests.connect.events.conftest import ALL, API
from tests.ports import reserved_port
from webapp.connect.events import mail
from webapp.connect.events.command import events
from webapp.errors import InputError, NotReady, UsageError
from webapp.settings import EventSettings, MailSettings, Settings
from webapp.store.accounts import accounts
from webapp.store.outbox import EventReceiver
from webapp.store.schema import Account

TO = "eva@example.org"
pytestmark = pytest.mark.filterwarnings("ignore:Requiring AUTH while not requiring TLS")


class Mailbox:
    """What the mail server has got; `refusal` is its answer to recipients, if it refuses them."""

    def __init__(self, port):
        self.port, self.got, self.refusal = port, [], None

    async def handle_RCPT(self, _server, _session, envelope, address, _options):  # noqa: N802
        if self.refusal is not None:
            return self.refusal
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, _server, _session, envelope):  # noqa: N802
        self.got.append((envelope.rcpt_tos, message_from_bytes(envelope.content, policy=default)))
        return "250 accepted"

    @property
    def texts(self):
        return [message.get_content().replace("\r\n", "\n") for _, message in self.got]


def _sign_in(_server, _session, _envelope, _mechanism, given):
    return AuthResult(success=(given.login, given.password) == (b"maps", b"right"), handled=False)


@pytest.fixture
def mailbox():
    with reserved_port() as port:
        box = Mailbox(port)
        needs = {"auth_require_tls": False, "auth_required": True, "authenticator": _sign_in}
        server = Controller(box, hostname="127.0.0.1", port=port, **needs)
        server.start()
        yield box
        server.stop()


@pytest.fixture
def settings(tmp_path, database_url, mailbox):
    return Settings(
        library=tmp_path / "library",
        database=database_url,
        events=EventSettings(site="https://maps.example.org/", timeout_s=1.0),
        mail=MailSettings(
            host="127.0.0.1",
            port=mailbox.port,
            security="none",
            user="maps",
            password="right",
            sender="Maps <maps@example.org>",
        ),
    )


@pytest.fixture
def confirmed(add, work, mailbox, client):
    """A receiver of the owner whose address is confirmed."""
    added = add("mail", TO)
    work()
    code = re.search(r"^[A-Z2-7]{12}$", mailbox.texts[0], re.MULTILINE)[0]
    answer = client.post(f"{API}/{added['id']}/confirm", json={"code": f" {code.lower()}\n"})
    assert answer.json["confirmed"] is True
    mailbox.got.clear()
    return added


def test_an_address_gets_its_code_and_nothing_else_before_it_is_confirmed(add, work, mailbox, client, park):
    added = add("mail", TO)
    assert (added["confirmed"], added["secret"]) == (False, None)
    client.post(f"/api/v1/maps/{park}/shares", json={})
    work()
    assert len(mailbox.got) == 1
    assert "Enter this code" in mailbox.texts[0]
    wrong = client.post(f"{API}/{added['id']}/confirm", json={"code": "AAAAAAAAAAAA"})
    assert wrong.json["error"]["message"] == "this is not the code"
    assert client.get(API).json["receivers"][0]["confirmed"] is False


def test_an_event_arrives_as_a_plain_message_with_a_link(confirmed, work, mailbox, client, park):
    client.post(f"/api/v1/maps/{park}/shares", json={"public": True})
    work()
    ((to, message),) = mailbox.got
    assert to == [TO]
    assert (message["To"], message["From"]) == (TO, "Maps <maps@example.org>")
    assert message["Subject"] == "Park: owner made a public link"
    assert message["Auto-Submitted"] == "auto-generated"
    assert re.fullmatch(r"<evt_[0-9a-f]{24}@example\.org>", message["Message-ID"])
    assert f"https://maps.example.org/maps/{park}/edit\n" in mailbox.texts[0]


def test_an_invitation_is_in_the_language_of_the_account(
    sign_in, new_account, add, work, mailbox, client, park, library
):
    eva = new_account("Eva")
    theirs = sign_in(eva)
    theirs.post(API, json={"kind": "mail", "address": TO, "events": ALL})
    with library.database.write() as session:
        session.query(EventReceiver).one().confirmed_at = eva.created_at
        session.get_one(Account, eva.id).language = "de"
    for role in ("viewer", "editor"):  # a change of the role is no invitation
        client.post(f"/api/v1/maps/{park}/members", json={"name": "Eva", "role": role})
    work()
    subjects = [message["Subject"] for _, message in mailbox.got]
    assert sorted(subjects) == sorted(["Diese Adresse bestätigen", "Die Karte Park wurde mit Ihnen geteilt"])


def test_a_name_cannot_add_headers(confirmed, work, mailbox, client, library, owner):
    with library.database.write() as session:
        session.get_one(Account, owner.id).name = "Eva\r\nBcc: all@example.org"
    slug = client.post("/api/v1/maps", json={"name": "Park"}).json["slug"]
    client.post(f"/api/v1/maps/{slug}/shares", json={})
    work()
    ((to, message),) = mailbox.got
    assert to == [TO]
    assert message["Bcc"] is None
    assert message["Subject"] == "Park: Eva Bcc: all@example.org made a secret link"


@pytest.mark.parametrize(
    ("refusal", "said"),
    [("550 no such user", "refuses the address (550)"), ("451 later", "refuses the address (451)")],
)
def test_a_refused_address_is_shown_and_tried_again(
    confirmed, work, mailbox, client, refusal, said, messages
):
    mailbox.refusal = refusal
    client.post(f"{API}/{confirmed['id']}/test")
    work()
    assert said in client.get(API).json["messages"][0]["error"]
    mailbox.refusal = None
    client.post(f"{API}/{confirmed['id']}/test")  # tries what waits, at once
    work()
    assert messages() == ["sent", "sent"]
    assert [message["Subject"] for _, message in mailbox.got] == ["A test message of Experience Map"]


def test_a_wrong_password_is_a_clear_sentence(settings):
    wrong = replace(settings.mail, password="wrong")
    message = mail.compose(wrong, TO, subject="A", text="B\n")
    with pytest.raises(InputError, match=r"refuses user or password \(535\)") as caught:
        mail.send(wrong, message, timeout_s=1.0)
    assert "wrong" not in str(caught.value)


@pytest.mark.parametrize("trusted", [True, False])
def test_starttls_needs_a_certificate_that_is_trusted(settings, tmp_path, monkeypatch, trusted):
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    name = "-subj /CN=localhost -addext subjectAltName=DNS:localhost"
    words = f"req -x509 -newkey rsa:2048 -nodes -days 2 {name}"
    files = ["-keyout", tmp_path / "key", "-out", tmp_path / "certificate"]
    subprocess.run(["openssl", *words.split(), *files], check=True, capture_output=True)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(tmp_path / "certificate", tmp_path / "key")
    if trusted:
        monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "certificate"))
    with reserved_port() as port:
        box = Mailbox(port)
        needs = {"tls_context": context, "require_starttls": True, "authenticator": _sign_in}
        server = Controller(box, hostname="127.0.0.1", port=port, **needs)
        server.start()
        secure = replace(settings.mail, host="localhost", port=port, security="starttls")
        message = mail.compose(secure, TO, subject="A", text="B\n")
        try:
            if trusted:
                mail.send(secure, message, timeout_s=5.0)
            else:
                with pytest.raises(InputError, match="SSLCertVerificationError"):
                    mail.send(secure, message, timeout_s=5.0)
        finally:
            server.stop()
    assert len(box.got) == trusted


def test_a_server_without_tls_gets_no_password(settings, mailbox):
    secure = replace(settings.mail, security="starttls")
    message = mail.compose(secure, TO, subject="A", text="B\n")
    with pytest.raises(InputError, match="STARTTLS"):
        mail.send(secure, message, timeout_s=1.0)
    assert mailbox.got == []


def test_a_server_that_only_trickles_is_left_after_a_while(settings):
    stop = threading.Event()

    def serve():
        connection, _ = server.accept()
        with connection:
            while not stop.wait(0.1):
                try:
                    connection.sendall(b"2")
                except OSError:
                    return

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        slow = replace(settings.mail, port=server.getsockname()[1])
        begun = time.monotonic()
        with pytest.raises(InputError, match="refuses the connection"):
            mail.send(slow, mail.compose(slow, TO, subject="A", text="B\n"), timeout_s=0.3)
        assert 1.0 < time.monotonic() - begun < 10.0
        stop.set()
        thread.join()


@pytest.mark.parametrize(
    "address",
    ["", "eva", "eva@", "eva@localhost", "a@b.org, c@d.org", "a@b.org\r\nBcc: c@d.org", "Eva <a@b.org>",
     "a b@c.org", "é@b.org", "a@" + "b" * 250 + ".org"],
)  # fmt: skip
def test_what_is_no_address_is_refused(client, address):
    answer = client.post(API, json={"kind": "mail", "address": address, "events": []})
    assert answer.json["error"]["message"] == "this is not an e-mail address"
    with pytest.raises(UsageError):
        mail.check_address(address)


def test_without_a_mail_server_the_page_and_the_api_say_so(tmp_path, new_library):
    from tests.web.conftest import Browser
    from webapp.app.web import create_app

    library = new_library(tmp_path / "other")
    app = create_app(Settings(library=tmp_path / "other"), library=library)
    app.testing, app.test_client_class = True, Browser
    with library.database.write() as session:
        token = accounts.new_token(session, accounts.ensure_owner(session), name="test")
    headers = {"Authorization": f"Bearer {token}"}
    client = app.test_client()
    answer = client.post(API, json={"kind": "mail", "address": TO, "events": []}, headers=headers)
    assert answer.json["error"]["message"] == "this server sends no e-mail"
    assert client.get(API, headers=headers).json["mail"] is False
    with pytest.raises(NotReady):
        mail.send(MailSettings(), mail.compose(MailSettings(), TO, subject="A", text="B"), timeout_s=1.0)


def test_the_command_sends_a_test_message(mailbox, monkeypatch):
    for name, value in (("HOST", "127.0.0.1"), ("PORT", mailbox.port), ("SECURITY", "none"),
                        ("USER", "maps"), ("PASSWORD", "right"), ("SENDER", "maps@example.org")):  # fmt: skip
        monkeypatch.setenv(f"EXPMAP_MAIL_{name}", str(value))
    done = CliRunner().invoke(events, [TO])
    assert done.output == f"the mail server has accepted a message to {TO}\n"
    assert [to for to, _ in mailbox.got] == [[TO]]
