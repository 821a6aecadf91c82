"""Text responses are compressed for clients that accept it."""

import gzip

GZIP = {"Accept-Encoding": "gzip"}


def test_pages_and_json_are_compressed(client, park):
    for address in ("/", "/api/v1/openapi.json", "/maps/park/edit"):
        plain, packed = client.get(address), client.get(address, headers=GZIP)
        assert packed.headers["Content-Encoding"] == "gzip" and "Content-Encoding" not in plain.headers
        assert len(packed.data) < len(plain.data) / 2
        assert "Accept-Encoding" in packed.vary and "Accept-Encoding" in plain.vary
    assert (
        gzip.decompress(client.get("/api/v1/openapi.json", headers=GZIP).data)
        == client.get("/api/v1/openapi.json").data
    )


def test_small_answers_and_files_are_not(client, park):
    assert "Content-Encoding" not in client.get("/healthz", headers=GZIP).headers
    with client.get("/static/" + "0" * 16 + "/img/icon-192.png", headers=GZIP) as picture:
        assert "Content-Encoding" not in picture.headers


def test_who_refuses_gets_it_plain(client):
    assert "Content-Encoding" not in client.get("/", headers={"Accept-Encoding": "gzip;q=0"}).headers


def test_the_length_does_not_tell_what_is_in_a_page(client):
    lengths = {len(client.get("/api/v1/openapi.json", headers=GZIP).data) for _ in range(12)}
    assert len(lengths) > 3
