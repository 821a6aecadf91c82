"""Photos of a map get global descriptors, once each, which answers use."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.conftest import textured
from tests.standin_models import tiny_image, write_aliked
from webapp.core.features.global_descriptor import GlobalDescriptor
from webapp.core.hypotheses import looks
from webapp.errors import Cancelled
from webapp.progress import Progress
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.localize import build_map, describe_photos, trials
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

VERIFIED = OpenOptions(method="verified", jobs=1)


class Notes(Progress):
    """Records notes, and stops after a number of steps."""

    def __init__(self, stop_after=math.inf):
        self.notes, self.steps, self.describing = [], 0, False
        self.stop_after = stop_after

    def note(self, text):
        self.notes.append(text)
        self.describing = text == "computing global descriptors"

    def advance(self, steps=1):
        self.steps += steps * self.describing

    def cancelled(self):
        return self.steps >= self.stop_after


@pytest.fixture
def with_model(quick, tmp_path):
    """Settings with a global descriptor."""
    models = tmp_path / "models"
    models.mkdir()
    (models / "global.onnx").write_bytes(tiny_image())
    return replace(quick, models=models)


@pytest.fixture
def cfg(make_map, tmp_path):
    return make_map(tmp_path / "map", 6)


@pytest.fixture
def looked_at(monkeypatch):
    """Count the photos that the network has described."""
    seen = []
    describe = GlobalDescriptor.describe

    def note(self, photo):
        seen.append(photo.shape)
        return describe(self, photo)

    monkeypatch.setattr(GlobalDescriptor, "describe", note)
    return seen


def opened(cfg, settings, *, progress=None, **options):
    asked = replace(VERIFIED, **options)
    return open_pipeline(cfg, asked, settings=settings, progress=progress or Progress())


def stored(cfg):
    return sorted(cfg.parent.glob("derived/map/global-*.arrays"))


def test_only_new_photos_are_described(cfg, with_model, looked_at, edit, save_photo):
    opened(cfg, with_model)
    assert looked_at == [(240, 320, 3)] * 6
    save_photo(cfg.parent / "photos" / "new.jpg", 77)
    edit(cfg, lambda lines: lines.append("6;photos/new.jpg;150;50"))
    pipeline = opened(cfg, with_model)
    assert len(looked_at) == 7
    described = pipeline.opened.indexed.global_descriptors
    assert sorted(described.row.tolist()) == list(range(7))
    opened(cfg, with_model)
    assert len(looked_at) == 7 and len(stored(cfg)) == 1


def test_a_photo_that_is_renamed_or_moved_is_not_described_again(cfg, with_model, looked_at, edit):
    before = opened(cfg, with_model).opened.indexed.global_descriptors.of(2)
    (cfg.parent / "photos" / "2.jpg").rename(cfg.parent / "photos" / "other.jpg")
    edit(cfg, lambda lines: lines.__setitem__(3, "2;photos/other.jpg;320;120"))
    after = opened(cfg, with_model).opened.indexed.global_descriptors.of(2)
    assert (before == after).all() and len(looked_at) == 6


def test_what_was_described_before_a_stop_is_kept_and_the_end_is_the_same(
    cfg, with_model, looked_at, make_map, tmp_path
):
    with pytest.raises(Cancelled):
        opened(cfg, with_model, progress=Notes(stop_after=4))
    assert len(looked_at) == 4 and len(stored(cfg)) == 1
    opened(cfg, with_model)
    assert len(looked_at) == 6
    undisturbed = make_map(tmp_path / "other", 6)
    opened(undisturbed, with_model)
    assert stored(cfg)[0].read_bytes() == stored(undisturbed)[0].read_bytes()


def test_a_killed_process_loses_what_was_not_saved_yet_only(cfg, with_model, looked_at, monkeypatch):
    class Killed(BaseException):
        pass

    store = describe_photos._store
    monkeypatch.setattr(describe_photos, "_SAVED_EVERY_S", 0.0)

    def killed_at_the_third(opened, network, known):
        if len(known) > 2:
            raise Killed
        store(opened, network, known)

    monkeypatch.setattr(describe_photos, "_store", killed_at_the_third)
    with pytest.raises(Killed):
        opened(cfg, with_model)
    monkeypatch.setattr(describe_photos, "_store", store)
    opened(cfg, with_model)
    assert len(looked_at) == 3 + 4


def test_another_model_has_vectors_of_its_own(cfg, with_model, looked_at):
    first = opened(cfg, with_model)
    (with_model.models / "global.json").write_text('{"mean": [0.2, 0.2, 0.2]}')
    second = opened(cfg, with_model)
    assert len(looked_at) == 12 and len(stored(cfg)) == 2
    names = [p.opened.indexed.global_descriptors.network.weights for p in (first, second)]
    assert names[0] != names[1]
    (with_model.models / "global.json").unlink()
    opened(cfg, with_model)
    assert len(looked_at) == 12


def test_photos_that_cannot_be_read_any_more_are_left_out(cfg, with_model):
    opened(cfg, replace(with_model, models=None))
    (cfg.parent / "photos" / "4.jpg").write_bytes(b"no photo")
    indexed = opened(cfg, with_model).opened.indexed
    assert indexed.global_descriptors.of(4) is None
    assert indexed.global_descriptors.of(3) is not None


def test_both_looks_share_one_description(cfg, with_model, looked_at, monkeypatch):
    both = replace(with_model, models=write_aliked(with_model.models / "both"))
    (both.models / "global.onnx").write_bytes(tiny_image())
    report = build_map.build_map(cfg, replace(VERIFIED, method="auto"), settings=both, progress=Progress())
    assert report.second is not None and len(looked_at) == 6
    assert report.global_descriptor and report.second.global_descriptor
    pipeline = opened(cfg, both, method="auto")
    one, other = (look.opened.indexed.global_descriptors for look in pipeline.looks)
    assert one.vectors is other.vectors and one.network is other.network
    monkeypatch.setattr(looks, "CERTAIN", 1.1)
    assert pipeline.localize(cfg.parent / "photos" / "3.jpg", top=3).looks == ("sift", "aliked")
    assert len(looked_at) == 7, "a query is described once for both"


@pytest.mark.parametrize("content", [b"no model", tiny_image("w", "h")])
def test_a_model_that_cannot_be_used_is_noted_and_left_out(cfg, with_model, content):
    plain = answer(opened(cfg, replace(with_model, models=with_model.models / "none")), cfg)
    (with_model.models / "global.onnx").write_bytes(content)
    notes = Notes()
    pipeline = opened(cfg, with_model, progress=notes)
    told = "without the global descriptor: global.onnx: not a global descriptor"
    assert [note.startswith(told) for note in notes.notes].count(True) == 1
    assert answer(pipeline, cfg) == plain


def test_without_onnxruntime_it_is_noted_where_a_model_lies_only(cfg, with_model, absent):
    absent("learned")
    notes = Notes()
    assert opened(cfg, with_model, progress=notes).opened.indexed.global_descriptors is None
    assert any("onnxruntime is not installed" in note and "[learned]" in note for note in notes.notes)
    quiet = Notes()
    opened(cfg, replace(with_model, models=with_model.models / "none"), progress=quiet)
    assert not any("without" in note for note in quiet.notes)


def answer(pipeline, cfg, number=3):
    found = pipeline.localize(cfg.parent / "photos" / f"{number}.jpg", top=9)
    return [(h.position, h.probability, h.radius_px, h.experiences) for h in found.hypotheses]


def test_without_the_model_answers_are_what_they_were_to_the_last_bit(cfg, with_model):
    none = replace(with_model, models=with_model.models / "none")
    before = answer(opened(cfg, none), cfg)
    opened(cfg, with_model)
    after = opened(cfg, none)
    assert answer(after, cfg) == before
    assert after.looks[0].calibration.calibration.slope[-1] == 0.0


def test_photos_that_play_queries_are_hidden_from_it_too(cfg, with_model, monkeypatch):
    found = []
    look = trials.find_places

    def note(indexed, query, *, hide, **more):
        assert query.vector is not None
        found.append((hide, look(indexed, query, hide=hide, **more)))
        return found[-1][1]

    monkeypatch.setattr(trials, "find_places", note)
    pipeline = with_hidden_photos(opened(cfg, with_model))
    assert len(found) == 6
    for hidden, search in found:
        named = {pipeline.map.experiences[v.matched.photo].id for p in search.places for v in p.photos}
        assert named and not named & {*hidden}
    own = pipeline.map.experiences[2]
    shown = pipeline.localize(cfg.parent / own.photo, top=9, hide=frozenset({own.id}))
    assert all(own.id not in h.experiences for h in shown.hypotheses)


PLACES, EACH = 6, 3


def vague(place, seed):
    """Write a photo of a place whose details vary: only the large structures repeat."""
    rng = np.random.default_rng(1000 * place + seed)
    forms = cv2.GaussianBlur(textured(place).astype(float), None, 20.0)
    details = cv2.GaussianBlur(rng.normal(size=forms.shape), None, 4.0)
    whole = (forms - forms.mean()) / forms.std() * 20.0 + details / details.std() * 40.0
    return np.clip(128.0 + whole, 0, 255).astype(np.uint8)


@pytest.fixture
def vague_map(tmp_path):
    """A map of three photos at each of six places, and a query at each."""
    folder = tmp_path / "vague"
    (folder / "photos").mkdir(parents=True)
    cv2.imwrite(str(folder / "plan.png"), np.full((200, 100 * PLACES + 200), 200, np.uint8))
    lines = [f"plan.png;{100 * PLACES + 200};200"]
    for place in range(PLACES):
        for n in range(EACH + 1):
            name = f"photos/{place}-{n}.png"
            cv2.imwrite(str(folder / name), vague(place, n))
            if n < EACH:
                lines.append(f"{EACH * place + n};{name};{100 * place + 100 + 4 * n};{100 + 3 * n}")
    (folder / "map.cfg").write_text("\n".join(lines) + "\n")
    return folder / "map.cfg"


def rightly_placed(pipeline, cfg):
    """Count the queries that are answered correctly."""
    right = 0
    for place in range(PLACES):
        found = pipeline.localize(cfg.parent / "photos" / f"{place}-{EACH}.png", top=1)
        first = found.hypotheses[:1]
        right += bool(first) and math.dist(first[0].position, (100 * place + 104, 103)) <= 40
    return right


def test_a_map_whose_photos_share_no_details_is_answered_by_it(vague_map, with_model):
    options = {"right_within_px": 40.0, "map_kind": "metric"}
    without = opened(vague_map, replace(with_model, models=None), **options)
    described = opened(vague_map, with_model, **options)
    assert rightly_placed(without, vague_map) <= PLACES // 3
    assert rightly_placed(described, vague_map) >= 2 * PLACES // 3
    assert described.looks[0].calibration.calibration.slope[-1] > 0.1
