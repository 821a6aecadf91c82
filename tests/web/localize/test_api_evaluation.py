"""An evaluation is a job that editors start."""

API = "/api/v1/maps"


def test_it_is_queued_once(client, park):
    first = client.post(f"{API}/{park}/evaluation", json={"limit": 20})
    assert first.status_code == 202
    assert (first.json["kind"], first.json["state"], first.json["map"]) == ("evaluate", "queued", park)
    assert client.post(f"{API}/{park}/evaluation", json={}).json["id"] == first.json["id"]
    assert [job["id"] for job in client.get(f"/api/v1/jobs?map={park}").json["jobs"]] == [first.json["id"]]


def test_who_may_and_how_much(client, sign_in, new_account, new_map, owner):
    viewer = new_account("viewer")
    slug = new_map(owner, name="Shared", shared={viewer: "viewer"})
    assert sign_in(viewer).post(f"{API}/{slug}/evaluation", json={}).status_code == 403
    assert client.post(f"{API}/{slug}/evaluation", json={"limit": 0}).status_code == 422
    assert client.post(f"{API}/none/evaluation", json={}).status_code == 404
