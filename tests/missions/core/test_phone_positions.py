"""What apps on phones send, read as poses."""

import pytest

from webapp.errors import InputError
from webapp.missions.core.phone_positions import from_owntracks, from_parameters, pose, records
from webapp.missions.core.trajectory.batch import parse

AT = 1777629600.0
"""2026-05-01T10:00:00Z."""

OWNTRACKS = {
    "_type": "location",
    "lat": 50.1,
    "lon": 14.4,
    "tst": 1777629600,
    "acc": 12,
    "alt": 210,
    "batt": 80,
}


def test_a_position_of_owntracks_is_a_pose():
    record = pose(from_owntracks(OWNTRACKS), track="Anna")
    (part,) = parse([record]).tracks.values()
    assert (record["time"], record["height_m"], record["track"]) == (AT, 210.0, "Anna")
    assert part.poses.covariance_m2[0] == pytest.approx([63.2, 63.2, 0.0], abs=0.1)  # 12 m hold 68 %


@pytest.mark.parametrize(("sent", "battery"), [(80, 80.0), (-1, None), (None, None)])
def test_the_battery_of_a_phone_is_its_status(sent, battery):
    found = parse(records(from_owntracks(OWNTRACKS | {"batt": sent}), track="Anna"))
    assert [(one.robot, one.battery_percent) for one in found.statuses] == [("Anna", battery)][: sent == 80]


@pytest.mark.parametrize("kind", ["lwt", "transition", "waypoint", "status", "new one"])
def test_other_messages_of_owntracks_are_left_out(kind):
    assert from_owntracks({"_type": kind}) is None


def test_an_encrypted_message_is_refused():
    with pytest.raises(InputError, match="encrypted") as refused:
        from_owntracks({"_type": "encrypted", "data": "x"})
    assert "OwnTracks" in refused.value.hint


@pytest.mark.parametrize(
    "sent",
    [
        {"lat": "50.1", "lon": "14.4", "time": "2026-05-01T10:00:00.000Z", "acc": "5"},  # GPSLogger
        {
            "lat": "50.1",
            "long": "14.4",
            "time": "2026-05-01T12:00:00 02:00",
        },  # a plus sign, decoded as a blank
        {
            "id": "7",
            "timestamp": "1777629600",
            "lat": "50.1",
            "lon": "14.4",
            "accuracy": "5",
        },  # Traccar Client
        {"lat": "50.1", "lon": "14.4", "timestamp": "1777629600000", "hdop": "2"},  # OsmAnd
        {"LAT": "50.1", "LON": "14.4", "Time": "1777629600"},
    ],
    ids=["gpslogger", "offset", "traccar", "osmand", "capitals"],
)
def test_parameters_of_other_apps(sent):
    found = from_parameters(sent)
    assert (found["lat"], found["lon"], found["time"]) == (50.1, 14.4, AT)
    assert found.get("accuracy_m") in (None, 5.0)


def test_an_accuracy_below_0_is_not_known():
    assert "covariance" not in pose(from_owntracks(OWNTRACKS | {"acc": -1}), track="")


@pytest.mark.parametrize(
    ("sent", "where"),
    [
        ({"lon": "14.4", "time": "1777629600"}, "lat"),
        ({"lat": "50.1", "lon": "", "time": "1777629600"}, "lon"),
        ({"lat": "50.1", "lon": "14.4"}, "time"),
        ({"lat": "fifty", "lon": "14.4", "time": "1777629600"}, "lat"),
        ({"lat": "nan", "lon": "14.4", "time": "1777629600"}, "lat"),
        ({"lat": "50.1", "lon": "14.4", "time": "yesterday"}, "time"),
        ({"lat": "50.1", "lon": "14.4", "time": "2026-05-01T10:00:00"}, "time"),
        ({"lat": "50.1", "lon": "14.4", "time": "2026-55-01T10:00:00Z"}, "time"),
    ],
)
def test_what_is_not_a_position_is_refused(sent, where):
    with pytest.raises(InputError) as refused:
        from_parameters(sent)
    assert refused.value.where == where
