"""A replay sends the same records that an import of the file stores."""

import numpy as np
import pytest

from webapp.missions.core.trajectory.batch import parse
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.tasks import read_track, replay_track
from webapp.missions.tasks.place_track import ReadOptions


@pytest.mark.parametrize("least", [MinMove(), MinMove(0.0)])
def test_a_replayed_bag_is_the_imported_one(shared_data, least):
    bag = shared_data / "robot" / "test1.bag"
    replayed = replay_track.replay_track(bag, min_move=least)
    (imported,) = read_track.read_track(bag, options=ReadOptions(min_move=least)).tracks
    batch = parse([event.record for event in replayed.events])
    part = batch.tracks["gps", f"test1 {imported.name}"]  # the name that an import gives it
    for name in ("times_s", "latlon", "height_m", "covariance_m2", "travelled_m"):
        np.testing.assert_array_equal(getattr(part.poses, name), getattr(imported.poses, name))
    assert replayed.skipped == imported.skipped >= part.skipped
    assert [event.time_s for event in replayed.events] == sorted(event.time_s for event in replayed.events)
    assert sum(left.count for left in replayed.left_out) == 11865 + 3952


def test_tracks_and_objects_come_in_the_order_of_their_times(tmp_path):
    file = tmp_path / "walk.csv"
    file.write_text("time,lat,lon\n10,50,14\n30,50.1,14\n20,50.2,14\n")
    replayed = replay_track.replay_track(file, min_move=MinMove(0.0))
    assert [event.record["time"] for event in replayed.events] == [10, 30, 20]  # a track keeps its own order


def test_what_was_left_out_at_the_end_is_reported(tmp_path):
    file = tmp_path / "stop.csv"
    file.write_text("time,lat,lon\n" + "".join(f"{n},{50 + min(n, 3) * 1e-3},14\n" for n in range(10)))
    replayed = replay_track.replay_track(file, min_move=MinMove())
    (imported,) = read_track.read_track(file, options=ReadOptions()).tracks
    records = [event.record for event in replayed.events]
    (part,) = parse([*records, {"type": "end", "left_out": replayed.rest}]).tracks.values()
    assert (len(part.poses), part.skipped) == (4, 6) == (len(imported.poses), imported.skipped)
    assert part.travelled_m == imported.distance_m
