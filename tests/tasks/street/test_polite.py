"""Contacted hosts, and data sent to them."""

import pytest

from webapp.errors import InputError, TooMany
from webapp.net.polite import PoliteClient
from webapp.settings import StreetSettings

SETTINGS = StreetSettings(photo_hosts="fbcdn.net, photos.example", requests_per_second=1000.0)


@pytest.fixture
def client():
    base = "https://graph.example"
    return PoliteClient("Service", base, headers={"Authorization": "OAuth secret"}, settings=SETTINGS)


class Answer:
    """A response like those of `requests`."""

    is_redirect, ok = False, True

    def __init__(self, status=200, headers=None):
        self.status_code, self.headers = status, headers or {}
        self.ok, self.is_redirect = status == 200, 300 <= status < 400

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def iter_content(self, _size):
        yield b"photo"


class Asked(list):
    """Recorded requests, and responses to return first."""

    def __init__(self):
        super().__init__()
        self.answers = []


@pytest.fixture
def asked(client, monkeypatch):
    """The requests made, each with its headers."""
    made = Asked()

    def get(address, *, headers, **_):
        made.append((address, dict(headers)))
        return made.answers.pop(0) if made.answers else Answer()

    monkeypatch.setattr(client._session, "get", get)
    return made


@pytest.mark.parametrize(
    "address",
    [
        r"https://evil.example\\@x.fbcdn.net/p.jpg",
        "https://x.fbcdn.net@evil.example/p.jpg",
        "https://graph.example@evil.example/p.jpg",
        "https://evil.example#.fbcdn.net/p.jpg",
        "https://evilfbcdn.net/p.jpg",
        "http://x.fbcdn.net/p.jpg",
        "https://[bad/p.jpg",
        "https://x.fbcdn.net/\n p.jpg",
        "file:///etc/passwd",
    ],
)
def test_other_hosts_are_not_asked(client, asked, address):
    with pytest.raises(InputError, match="which is not allowed"):
        client.photo(address, max_bytes=100)
    assert asked == []


def test_a_redirect_to_another_host_is_not_followed(client, asked):
    asked.answers = [Answer(302, {"Location": r"https://evil.example\\@x.fbcdn.net/p.jpg"})]
    with pytest.raises(InputError, match="which is not allowed"):
        client.photo("https://x.fbcdn.net/p.jpg", max_bytes=100)
    assert len(asked) == 1


@pytest.mark.parametrize("location", ["https://[bad", "//[bad/x"])
def test_a_redirect_to_no_address_is_an_error_of_this_photo(client, asked, location):
    asked.answers = [Answer(302, {"Location": location})]
    with pytest.raises(InputError):
        client.photo("https://x.fbcdn.net/p.jpg", max_bytes=100)


def test_the_token_goes_to_the_service_alone(client, asked):
    assert client.photo("https://graph.example/p.jpg", max_bytes=100) == b"photo"
    assert client.photo("https://a.photos.example/p.jpg", max_bytes=100) == b"photo"
    assert [headers for _, headers in asked] == [{"Authorization": "OAuth secret"}, {}]


def test_a_pause_without_end_is_refused(client, asked):
    asked.answers = [Answer(429, {"Retry-After": "9" * 400})]
    with pytest.raises(TooMany):
        client.photo("https://graph.example/p.jpg", max_bytes=100)


def test_the_next_page_of_no_address_is_an_error(client, asked):
    with pytest.raises(InputError, match="leads to another host"):
        client.json("https://[bad")
    assert asked == []


def test_a_service_without_an_address_is_an_error():
    with pytest.raises(InputError, match="has an invalid address"):
        PoliteClient("Service", "https://[bad", settings=SETTINGS)
