"""Messages that are in a spool are recognised when repeated."""

from expmap_ros.sent import Numbering, SentMessages, object_identity, pose_identity

PLACE = {"time": 1.0, "lat": 50.0, "lon": 14.0}


def test_poses_and_objects_of_a_spool_are_known_even_objects_without_an_id():
    seen = {"type": "object", "class": "car", "height_m": 0.0, **PLACE}
    elsewhere = seen | {"lat": 50.1}
    sent = SentMessages([{"type": "end"}, seen, elsewhere, seen | {"id": "car 1"}, {"type": "pose", **PLACE}])
    assert object_identity("car 1", 1.0) in sent
    again, other, larger = Numbering(), Numbering(), Numbering()

    def car(numbering, **changed):
        fields = {"confidence": None, "size_m": None, "in_image": False} | changed
        return numbering.identity("car", 1.0, **fields)

    assert [car(again) in sent for _ in range(3)] == [True, True, False]
    assert car(other, in_image=True) not in sent
    assert car(larger, size_m=(1.0, 1.0, 1.0)) not in sent
    assert pose_identity("gps", "", 1.0, lat=50.0, lon=14.0) in sent
    assert object_identity("car 2", 1.0) not in sent
