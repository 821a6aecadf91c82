"""The owner's page of models: what is installed, one click that fetches, and uploads that are checked."""

from dataclasses import replace

import pytest
from sqlalchemy import select

from tests.standin_models import brightest
from webapp.store.schema import Job


@pytest.fixture
def settings(settings, tmp_path):
    return replace(settings, models=tmp_path / "models")


def queued(library):
    with library.database.read() as session:
        return [(job.kind, job.arguments) for job in session.scalars(select(Job))]


def test_the_owner_sees_each_model_with_licence_hash_purpose_and_state(client):
    page = client.get("/server/models").text
    assert "Apache-2.0" in page and "a721f366f54b20328fa98c799cc31478edb1c31f0c941528df3d363c3753760d" in page
    assert "The second look of method auto" in page and "not installed" in page
    assert 'data-testid="fetch-second-look"' in page
    assert 'href="/server/models"' in client.get("/").text


def test_others_neither_see_nor_change_it(sign_in, new_account, library):
    client = sign_in(new_account("Eva"))
    assert client.get("/server/models").status_code == 403
    assert client.post("/server/models/fetch", data={"model": "xfeat"}).status_code == 403
    assert client.put("/api/v1/models/disk", data=b"x").status_code == 403
    assert "/server/models" not in client.get("/").text
    assert queued(library) == []


def test_one_click_queues_a_job_and_fetches_nothing_itself(client, library):
    answer = client.post("/server/models/fetch", data={"model": ["xfeat", "lighterglue"]})
    assert answer.status_code in (302, 303)
    assert queued(library) == [("models", {"models": ["xfeat", "lighterglue"]})]
    assert client.post("/server/models/fetch", data={"model": "nothing"}).status_code == 400
    assert client.post("/server/models/fetch", data={}).status_code in (302, 303)
    assert len(queued(library)) == 1


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("xfeat", b"PK", "not the published file"),
        ("disk", b"#!/bin/sh", "onnxruntime can run"),
        ("global", b"", "not a global descriptor"),
    ],
)
def test_a_file_that_is_not_what_it_says_is_refused(client, settings, library, name, content, message):
    answer = client.put(f"/api/v1/models/{name}", data=content)
    assert answer.status_code == 422 and message in answer.json["error"]["message"]
    assert not settings.models.exists() and not [*library.inner.glob("model-*")]
    assert client.put("/api/v1/models/none", data=content).status_code == 404


def test_a_network_of_ones_own_is_installed(client, settings):
    answer = client.put("/api/v1/models/disk", data=brightest("disk"))
    assert (answer.status_code, answer.json) == (200, {"model": "disk", "file": "disk.onnx"})
    assert (settings.models / "disk.onnx").read_bytes() == brightest("disk")
    assert "installed" in client.get("/server/models").text


def test_the_page_of_queries_names_the_missing_look_to_the_owner_only(
    client, park, sign_in, new_account, new_map
):
    assert "second-look-missing" in client.get(f"/maps/{park}/localize").text
    eva = new_account("Eva")
    assert "second-look-missing" not in sign_in(eva).get(f"/maps/{new_map(eva)}/localize").text
