"""Quick queries do not wait for slow ones, and the number of parallel ones is limited."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from webapp.core.hypotheses.model import AnswerSource
from webapp.settings import Settings
from webapp.tasks.localize import spot, upload
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto


@dataclass(frozen=True)
class Localizer:
    """Records how it was called."""

    method: str
    fov_deg: float | None = None
    features: str = "any"
    map = SimpleNamespace(georeference=None)

    def observe(self, photo, **options):
        """Replaced by `Looks.look`."""

    def answer_source(self, *, sequence):
        return AnswerSource(self.method, "sift", None, map_revision=0, sequence=sequence)


class Looks:
    """Looks that last until they are released, by method."""

    def __init__(self):
        self.busy, self.most, self.changed = {}, {}, threading.Condition()
        self.go = {method: threading.Event() for method in ("verified", "thorough")}

    def look(self, localizer, _photo, **_options):
        method = localizer.method
        with self.changed:
            self.busy[method] = self.busy.get(method, 0) + 1
            self.most[method] = max(self.most.get(method, 0), self.busy[method])
            self.changed.notify_all()
        assert self.go[method].wait(10)
        with self.changed:
            self.busy[method] -= 1

    def wait_for(self, method, busy):
        """Wait until a number of looks of a method are running."""
        with self.changed:
            assert self.changed.wait_for(lambda: self.busy.get(method) == busy, 10)


@pytest.fixture
def looks(monkeypatch):
    made = Looks()
    monkeypatch.setattr(Localizer, "observe", lambda *given, **named: made.look(*given, **named))
    monkeypatch.setattr(spot, "combine", lambda *_, **__: (SimpleNamespace(evidence=()), 0))
    monkeypatch.setattr(upload, "read_facts", lambda *_, **__: None)
    monkeypatch.setattr(upload, "answer_to_json", lambda *_, **__: {})
    yield made
    for go in made.go.values():
        go.set()


@pytest.fixture
def threads():
    with ThreadPoolExecutor(8) as pool:
        yield pool


def asked(method):
    maps = SimpleNamespace(
        get=lambda _id, options: SimpleNamespace(pipeline=Localizer(options.method), revision=1),
        settings=Settings(),
    )
    request = LocalizeRequest((UploadedPhoto(Path("a.jpg"), "a.jpg"),), OpenOptions(method))
    return upload.localize_uploads(maps, 1, request=request)


def test_quick_questions_do_not_wait_for_thorough_ones(threads, looks):
    slow = [threads.submit(asked, "thorough") for _ in range(3)]
    looks.wait_for("thorough", 1)
    looks.go["verified"].set()
    for _ in range(3):
        threads.submit(asked, "verified").result(timeout=60)
    assert not any(run.done() for run in slow)


@pytest.mark.parametrize(("method", "most"), [("verified", 2), ("thorough", 1)])
def test_so_many_are_answered_at_once(threads, looks, method, most):
    runs = [threads.submit(asked, method) for _ in range(6)]
    looks.wait_for(method, most)
    looks.go[method].set()
    for run in runs:
        run.result(timeout=60)
    assert looks.most[method] == most
