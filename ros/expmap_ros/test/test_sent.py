"""Which messages of a spool are known again."""

from expmap_ros.sent import SentMessages, object_identity, pose_identity

PLACE = {"time": 1.0, "lat": 50.0, "lon": 14.0}


def test_poses_and_objects_of_a_spool_are_known_even_objects_without_an_id():
    seen = {"type": "object", "class": "car", **PLACE}
    sent = SentMessages([{"type": "end"}, seen, seen | {"id": "car 1"}, {"type": "pose", **PLACE}])
    assert object_identity("car 1", 1.0) in sent
    assert ("object", None, 1.0, 50.0, 14.0) in sent
    assert pose_identity("gps", "", 1.0, lat=50.0, lon=14.0) in sent
    assert object_identity("car 2", 1.0) not in sent
