"""A match database whose writer was killed."""

import numpy as np
import pycolmap

from webapp.core.features.types import Features
from webapp.files.landmarks.match_database import MatchDatabase

FEATURES = Features(
    xy=np.ones((3, 2), np.float32),
    size=np.ones(3, np.float32),
    angle=np.zeros(3, np.float32),
    descriptors=np.zeros((3, 128), np.uint8),
    photo_size=(640, 480),
)


def test_an_image_whose_frame_was_not_written_any_more_makes_it_begin_anew(tmp_path):
    path = tmp_path / "matches.db"
    database = MatchDatabase(path)
    database.add("one", FEATURES, fov_deg=60.0, is_guessed=False)
    database.close()
    killed = pycolmap.Database.open(path)
    killed.write_image(pycolmap.Image(name="two", camera_id=1))
    killed.close()
    database = MatchDatabase(path)
    for content in ("one", "two"):
        database.add(content, FEATURES, fov_deg=60.0, is_guessed=False)
    database.close()
    after = pycolmap.Database.open(path)
    assert after.num_images() == after.num_frames() == 2
    pycolmap.DatabaseCache.create(after, pycolmap.DatabaseCacheOptions())
