"""Blurred parts of a map photo are not used for recognition."""

from dataclasses import replace

import pytest

from tests.opening import open_first_look
from webapp.core.boxes import BlurBox
from webapp.core.features.table import FeatureChoice
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize.extract_photo import PhotoJob, extract_photo
from webapp.tasks.localize.plan import OpenOptions

BOX = BlurBox(0.25, 0.3, 0.4, 0.5)


@pytest.fixture
def keypoints(make_map, tmp_path):
    """Extract the features of a photo, and return the numbers of keypoints inside and outside `BOX`."""
    cfg = make_map(tmp_path, 1)
    index = IndexFolder(tmp_path / "index")
    index.folder.mkdir()
    index.make_spool()

    def run(detector, *, blurred):
        choice = FeatureChoice(detector, detector, "")
        job = PhotoJob(0, cfg, "photos/0.jpg", index.folder, choice, Settings(), blurred=blurred)
        features = read_segment(index.spool_path(extract_photo(job).content)).entry(0).features
        x, y = ((features.xy + 0.5) / features.photo_size).T
        across, down = x - BOX.x, y - BOX.y
        inside = (across > 0) & (across < BOX.width) & (down > 0) & (down < BOX.height)
        return inside.sum(), (~inside).sum()

    return run


@pytest.mark.parametrize("detector", ["sift", "orb"])
def test_no_keypoint_is_in_a_box(keypoints, detector):
    inside, outside = keypoints(detector, blurred=())
    assert min(inside, outside) > 10
    inside_now, outside_now = keypoints(detector, blurred=(BOX,))
    assert inside_now == 0
    assert 10 < outside_now <= outside


def test_a_blurred_photo_alone_is_described_again(make_map, tmp_path, build, described):
    cfg = make_map(tmp_path, 4)
    before = build(cfg)
    described.clear()
    the_map = read_map(cfg)
    first, *others = the_map.experiences
    write_map(cfg, replace(the_map, experiences=(replace(first, blurred=(BOX,)), *others)))
    report = build(cfg)
    assert (report.extracted, report.reused, described) == (1, 3, ["0.jpg"])
    assert report.descriptors < before.descriptors
    write_map(cfg, the_map)
    assert build(cfg).descriptors == before.descriptors


def test_a_photo_that_was_described_with_what_is_blurred_now_waits_for_the_index(make_map, tmp_path):
    cfg = make_map(tmp_path, 4)

    def opened(*, build):
        options = OpenOptions(method="vote", features="sift", jobs=1, build=build)
        return open_first_look(cfg, options, settings=Settings(), progress=Progress())

    assert opened(build=True).not_indexed == 0
    the_map = read_map(cfg)
    first, *others = the_map.experiences
    write_map(cfg, replace(the_map, experiences=(replace(first, blurred=(BOX,)), *others)))
    before = opened(build=False)
    assert (before.not_indexed, before.contents.count("")) == (1, 1)  # so that a server describes it again
    after = opened(build=True)
    assert (after.not_indexed, after.contents.count("")) == (0, 0)
