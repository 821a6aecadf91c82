"""Weights are downloaded completely and verified, or not at all."""

import hashlib
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.standin_models import brightest, glue
from webapp.core.features.entry import ModelFile
from webapp.core.features.lightglue import LightGlue
from webapp.core.features.table import choose
from webapp.errors import InputError, MissingPart, NotFound, UsageError
from webapp.files.localize import models as files
from webapp.files.localize.index_store import index_key
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.operate import models as task
from webapp.tasks.operate.models import check_models

CONTENT = bytes(range(256)) * 1000


@pytest.fixture
def host():
    """A host that sends CONTENT, or half of it, or redirects."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            code = {"/gone": 404, "/moved": 302}.get(self.path, 200)
            body = CONTENT[: len(CONTENT) // 2] if self.path == "/half" else CONTENT
            body = body + b"more" if self.path == "/more" else body
            body = body[::-1] if self.path == "/other" else body
            self.send_response(code)
            self.send_header("Location", "/right")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture
def file(host):
    """The file to fetch."""
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    return ModelFile("net.onnx", len(CONTENT), sha256, "Apache-2.0", "its maker", f"{host}/right")


@pytest.fixture
def settings(tmp_path):
    """Settings with a folder of weights that does not exist yet."""
    return Settings(models=tmp_path / "kept" / "models")


def test_a_download_is_kept_and_then_known(file, settings):
    models = {"net": (file,)}
    assert [s.state for s in task.states(settings, models=models)] == ["missing"]
    assert task.missing((), settings=settings, models=models) == ["net"]
    path = task.fetch(
        task.choose_file("net", None, models=models), None, settings=settings, progress=Progress()
    )
    assert path.read_bytes() == CONTENT
    assert [s.state for s in task.states(settings, models=models)] == ["here"]
    assert task.missing((), settings=settings, models=models) == []


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("/gone", "answered 404"),
        ("/moved", "answered 302"),
        ("/half", "expected 256000 bytes, received 128000"),
        ("/more", "expected 256000 bytes, received more"),
        ("/other", "not the published file"),
    ],
)
def test_what_is_not_the_published_file_is_not_kept(host, file, settings, address, message):
    with pytest.raises(InputError, match=message):
        task.fetch(replace(file, address=host + address), None, settings=settings, progress=Progress())
    assert not settings.models.exists()


def test_no_network_is_reported_with_another_way(file, settings):
    unreachable = replace(file, address="http://127.0.0.1:1/net.onnx")
    with pytest.raises(InputError, match="cannot be reached") as failed:
        task.fetch(unreachable, None, settings=settings, progress=Progress())
    assert "--from" in str(failed.value.hint)


def test_any_of_the_files_in_a_folder_is_taken_and_is_enough(file, settings, tmp_path):
    models = {"net": (file, replace(file, name="other.onnx", address=""))}
    source = tmp_path / "brought"
    source.mkdir()
    with pytest.raises(NotFound, match=r"no net\.onnx or other\.onnx"):
        task.choose_file("net", source, models=models)
    (source / "other.onnx").write_bytes(CONTENT)
    chosen = task.choose_file("net", source, models=models)
    task.fetch(chosen, source, settings=settings, progress=Progress())
    assert [s.state for s in task.states(settings, models=models)] == ["missing", "here"]
    assert task.missing(["net"], settings=settings, models=models) == []


def test_a_wrong_file_from_a_folder_leaves_what_is_here(file, settings, tmp_path):
    settings.models.mkdir(parents=True)
    (settings.models / "net.onnx").write_bytes(CONTENT)
    (tmp_path / "net.onnx").write_bytes(CONTENT[::-1])
    with pytest.raises(InputError, match="not the published file"):
        task.fetch(file, tmp_path, settings=settings, progress=Progress())
    assert (settings.models / "net.onnx").read_bytes() == CONTENT


def test_a_damaged_file_is_reported_and_fetched_again(file, settings):
    settings.models.mkdir(parents=True)
    (settings.models / "net.onnx").write_bytes(CONTENT[::-1])
    models = {"net": (file,)}
    assert [s.state for s in task.states(settings, models=models)] == ["damaged"]
    assert task.missing((), settings=settings, models=models) == ["net"]


def test_an_unknown_model_is_refused_with_the_known_ones(settings):
    with pytest.raises(UsageError, match="xfeat"):
        task.missing(["superglue"], settings=settings)


def test_opening_says_what_is_missing_or_wrong(settings):
    assert files.network(None, settings.models) is None
    with pytest.raises(MissingPart, match="expmap models fetch"):
        files.network("xfeat", settings.models)
    settings.models.mkdir(parents=True)
    published = files.MODELS["xfeat"][1]
    (settings.models / published.name).write_bytes(bytes(published.bytes))
    with pytest.raises(MissingPart, match="not the published one"):
        files.network("xfeat", settings.models)


@pytest.mark.parametrize(
    ("model", "file", "hint"),
    [
        (model, file, "run expmap models fetch")
        for model, file in [("lighterglue", 0), ("xfeat", 1), ("xfeat", 0)]
    ],
)
def test_a_damaged_file_is_reported_with_the_way_to_get_it(settings, model, file, hint):
    settings.models.mkdir(parents=True)
    published = files.MODELS[model][file]
    (settings.models / published.name).write_bytes(bytes(published.bytes))
    with pytest.raises(MissingPart, match="not the published one") as damaged:
        files.pair_matcher("xfeat", settings.models) if model == "lighterglue" else files.network(
            model, settings.models
        )
    assert damaged.value.where == published.name
    assert damaged.value.hint.endswith("run expmap models fetch")


def test_a_model_is_opened_once(shared_models):
    assert files.network("xfeat", shared_models) is files.network("xfeat", shared_models)


OWN = ModelFile("mine.onnx", bytes=0, sha256="", licence="", source="its maker", address="")


def test_a_file_of_ones_own_is_here_or_missing_and_never_fetched(file, settings, tmp_path):
    models = {"net": (file,), "mine": (OWN,)}
    assert [s.state for s in task.states(settings, models=models)] == ["missing", "missing"]
    assert task.missing((), settings=settings, models=models) == ["net"]
    with pytest.raises(UsageError, match="no published file is pinned") as refused:
        task.missing(["net", "mine"], settings=settings, models=models)
    assert refused.value.where == "mine.onnx"
    assert "put it as mine.onnx into the folder" in refused.value.hint
    settings.models.mkdir(parents=True)
    (settings.models / "mine.onnx").write_bytes(b"anything")
    assert [s.state for s in task.states(settings, models=models)] == ["missing", "here"]


def test_a_published_file_without_an_address_comes_from_a_folder_only(file, settings, tmp_path):
    models = {"net": (replace(file, address=""),)}
    assert not task.is_available("net", None, models=models)
    assert not task.is_available("net", tmp_path, models=models)
    with pytest.raises(UsageError, match="address") as refused:
        task.choose_file("net", None, models=models)
    assert "--from" in refused.value.hint
    (tmp_path / "net.onnx").write_bytes(CONTENT)
    assert task.is_available("net", tmp_path, models=models)
    task.fetch(
        task.choose_file("net", tmp_path, models=models), tmp_path, settings=settings, progress=Progress()
    )
    assert [s.state for s in task.states(settings, models=models)] == ["here"]


@pytest.mark.parametrize("kind", ["aliked", "disk"])
def test_a_file_of_ones_own_is_known_by_its_content(settings, kind):
    choice = choose("verified", features=kind)
    with pytest.raises(MissingPart, match="are not installed") as missing:
        files.with_weights(choice, settings.models, method="verified")
    assert f"as {kind}.onnx into the folder that expmap models list prints" in missing.value.hint
    assert str(settings.models) not in str(missing.value)
    settings.models.mkdir(parents=True)
    path = settings.models / f"{kind}.onnx"
    path.write_bytes(brightest(kind))
    first = files.with_weights(choice, settings.models, method="verified")
    assert first.weights == hashlib.sha256(path.read_bytes()).hexdigest()
    opened = files.network(kind, settings.models, weights=first.weights)
    assert files.network(kind, settings.models) is opened
    path.write_bytes(brightest(kind, count=9))
    second = files.with_weights(choice, settings.models, method="verified")
    assert index_key(second, Settings().extract) != index_key(first, Settings().extract)
    assert files.network(kind, settings.models, weights=second.weights) is not opened
    assert files.network(kind, settings.models, weights=first.weights) is opened
    with pytest.raises(MissingPart, match="has changed") as changed:
        files.network(kind, settings.models, weights="0" * 64)
    assert "expmap build" in changed.value.hint
    path.write_bytes(b"no model")
    with pytest.raises(InputError, match="model that onnxruntime can run"):
        files.with_weights(choice, settings.models, method="verified")
    sift = choose("verified", features="sift")
    assert files.with_weights(sift, settings.models, method="verified").weights == ""


def test_photos_are_matched_by_the_network_for_their_features(settings, shared_models):
    for features in ("sift", "disk", "sift+xfeat"):
        with pytest.raises(UsageError, match="xfeat or aliked"):
            files.pair_matcher(features, settings.models)
    for features, hint in (("xfeat", "expmap models fetch"), ("aliked", "aliked_lightglue.onnx")):
        with pytest.raises(MissingPart, match=hint):
            files.pair_matcher(features, settings.models)
    settings.models.mkdir(parents=True)
    (settings.models / "aliked_lightglue.onnx").write_bytes(glue())
    opened = files.pair_matcher("aliked", settings.models)
    assert isinstance(opened, LightGlue)
    assert files.pair_matcher("aliked", settings.models) is opened
    (settings.models / "aliked_lightglue.onnx").write_bytes(glue(by="look"))
    assert files.pair_matcher("aliked", settings.models) is not opened
    assert isinstance(files.pair_matcher("xfeat", shared_models), LightGlue)


def test_all_models_of_the_second_look_have_an_address_and_a_hash():
    found = [file for name in task.SECOND_LOOK for file in files.MODELS[name]]
    assert len(found) == 3
    assert all(file.address.endswith(f"/{file.name}") and len(file.sha256) == 64 for file in found)
    assert task.PURPOSES.keys() == files.MODELS.keys()


def test_what_is_missing_is_said_with_what_it_would_bring(settings):
    said = task.advice(settings)
    assert said.startswith("xfeat and lighterglue not installed (6.5 MB): with them, 77 % instead of 25 %")
    assert "expmap models fetch" in said and "\n" not in said
    settings.models.mkdir(parents=True)
    (settings.models / "xfeat_640x640.onnx").touch()
    assert task.advice(settings).startswith(
        "lighterglue not installed (2.3 MB): with it, 77 % instead of 67 %"
    )
    (settings.models / "lighterglue_L3.onnx").touch()
    assert task.advice(settings) == ""


def test_nothing_is_advised_where_a_second_look_is_turned_off(settings):
    off = replace(settings, retrieval=replace(settings.retrieval, budget_s=0.0))
    assert task.advice(off) == ""


def test_an_uploaded_file_is_accepted_only_if_it_is_the_published_one(file, settings, tmp_path):
    sent = tmp_path / "sent"
    sent.write_bytes(CONTENT)
    models = {"net": (file,)}
    path = task.accept("net", sent, settings=settings, models=models)
    assert path == settings.models / file.name and path.read_bytes() == CONTENT
    sent.write_bytes(CONTENT[:-1] + b"x")
    with pytest.raises(InputError, match="not the published file"):
        task.accept("net", sent, settings=settings, models=models)
    with pytest.raises(NotFound, match="unknown model"):
        task.accept("nothing", sent, settings=settings)


def test_an_uploaded_network_of_ones_own_is_tried_first(settings, tmp_path):
    sent = tmp_path / "sent"
    sent.write_bytes(b"no network")
    for model in ("aliked", "aliked-lightglue", "global"):
        with pytest.raises(InputError):
            task.accept(model, sent, settings=settings)
    assert not settings.models.exists()
    sent.write_bytes(brightest("aliked"))
    assert task.accept("aliked", sent, settings=settings).name == "aliked.onnx"


def test_a_check_tells_inliers_and_time_of_each_installed_model(settings):
    settings.models.mkdir(parents=True)
    assert [*check_models(settings)] == []
    (settings.models / "aliked.onnx").write_bytes(brightest("aliked"))
    (settings.models / "aliked_lightglue.onnx").write_bytes(glue())
    (settings.models / "disk.onnx").write_bytes(b"no network")
    found = {one.model: one for one in check_models(settings)}
    assert found.keys() == {"aliked", "aliked-lightglue", "disk"}
    assert found["disk"].problem and found["disk"].milliseconds is None
    assert found["aliked-lightglue"].matches >= found["aliked-lightglue"].inliers >= 0
    assert found["aliked"].milliseconds > 0.0


def test_published_models_match_the_drawn_pictures(settings, shared_models):
    found = {one.model: one for one in check_models(replace(settings, models=shared_models))}
    assert min(found["xfeat"].inliers, found["lighterglue"].inliers) > 300
