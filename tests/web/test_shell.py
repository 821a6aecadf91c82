"""Errors, headers and who gets in."""


def test_health_needs_no_sign_in(stranger):
    assert stranger.get("/healthz").json["status"] == "ok"


def test_an_unknown_address_of_the_api_is_told_in_the_one_shape(client):
    answer = client.get("/api/v1/nothing")
    assert answer.status_code == 404
    assert set(answer.json["error"]) == {"code", "message", "hint", "where"}
    assert answer.json["error"]["code"] == "not_found"
