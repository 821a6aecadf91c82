"""Photos in which SIFT finds little in common are matched by a network, if one is installed."""

import shutil
from contextlib import closing

import numpy as np
import pytest

from webapp.core.landmarks.matching import match_mutually
from webapp.files.landmarks.cloud import CLOUD_FILE, read_cloud
from webapp.files.landmarks.match_database import MatchDatabase
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks import reconstruct
from webapp.tasks.landmarks.reconstruct import MatchingNetwork
from webapp.tasks.localize.index_location import landmarks_folder


class Standin(MatchingNetwork):
    """Matches SIFT's keypoints, which take the place of learned ones."""

    weights = "standin"

    def open(self):
        return self

    def match(self, query, photo):
        return match_mutually(query.descriptors, photo.descriptors).astype(np.int64)


@pytest.fixture
def network(court, monkeypatch):
    """SIFT itself finds nothing; a network is installed."""
    folder = landmarks_folder(court.cfg)
    shutil.rmtree(folder)
    monkeypatch.setattr(reconstruct, "match_mutually", lambda one, other: np.zeros((0, 2), np.uint32))
    standin = Standin(reconstruct._CHOICE, folder / "features-standin", "matches-standin.db", None)
    monkeypatch.setattr(reconstruct, "_network", lambda *_: standin)
    return standin


def joined(court):
    return reconstruct.reconstruct(court.cfg, read_map(court.cfg), settings=Settings(), progress=Progress())


def test_photos_are_joined_by_what_the_network_matches(court, network):
    found = joined(court)
    assert [len(one) for one in found.submodels] == [9]
    assert found.matches == landmarks_folder(court.cfg) / "matches-standin.db"
    kept = reconstruct._features(network.features, next(iter(found.number_of)))
    assert 0 < len(kept) <= reconstruct._LEARNED.keypoints


def test_matches_are_of_the_keypoints_after_those_of_sift_and_no_landmarks(court, network):
    found = joined(court)
    content = next(iter(found.number_of))
    own = len(read_segment(IndexFolder(found.shared).spool_path(content)).entry(0).features)
    with closing(MatchDatabase(found.matches)) as database:
        (first, second), *_ = database._inliers
        rows = database._database.read_two_view_geometry(first, second).inlier_matches
        assert database._database.num_keypoints_for_image(first) > own
    assert rows.min() >= own
    cloud = read_cloud(found.folder / CLOUD_FILE).cloud
    assert len(cloud.point) == 0, "queries are described by SIFT"


def test_a_network_that_is_installed_later_matches_anew(court, monkeypatch):
    before = joined(court)
    standin = Standin(
        reconstruct._CHOICE, landmarks_folder(court.cfg) / "features-standin", "matches-standin.db", None
    )
    monkeypatch.setattr(reconstruct, "_network", lambda *_: standin)
    after = joined(court)
    assert (before.matches.name, after.matches.name) == ("matches.db", "matches-standin.db")
    assert before.matches.exists(), "another computer may not have the network"
    assert [len(one) for one in after.submodels] == [9]


def test_pairs_with_few_inliers_by_the_network_are_those_of_sift(court, network, monkeypatch):
    monkeypatch.setattr(reconstruct, "_LEAST_BY_NETWORK", 100_000)
    assert joined(court).submodels == ()
