"""KML conforms to the standard, and can be read by other programs."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kml_rules import GX, KML, check_kml, fastkml
from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.outgoing import MissionExport
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.files.kml_writer import format_mission_kml, format_network_link


def written(mission, **more):
    return b"".join(format_mission_kml(mission, **more))


def read(mission):
    """Read tracks and objects with fastkml."""
    document = fastkml.KML.from_string(written(mission).decode()).features[0]
    assert document.name == mission.name.replace("\x07", "?")
    tracks, objects = document.features
    return tracks.features, objects.features


def test_it_keeps_to_the_structure_of_the_standard(mission):
    for icons in ({}, {"car": "icons/0.png", "victim": "icons/1.png"}):
        root = check_kml(written(mission, icons=icons))
        assert len(root.findall(f".//{GX}MultiTrack")) == len(mission.tracks)
        assert len(root.findall(f".//{KML}Point")) == 3
        assert [e.text for e in root.iter(f"{KML}href")] == list(icons.values())


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"</when>\n", b"</when>\n<when>2026-01-01T00:00:00Z</when>\n"),
        (b"<gx:interpolate>1</gx:interpolate>", b"<gx:interpolate>1</gx:interpolate><name>x</name>"),
        (b"<open>1</open>", b"<open>1</open><name>again</name>"),
        (b"<coordinates>14.", b"<coordinates>50.001,214."),
        (b"<gx:angles>", b"<gx:angles>0 0 "),
        (b"#kind-0</styleUrl>", b"#kind-77</styleUrl>"),
        (b"<begin>2023", b"<begin>2033"),
    ],
)
def test_the_check_itself_finds_what_is_wrong(mission, before, after):
    good = written(mission)
    assert before in good
    with pytest.raises(AssertionError):
        check_kml(good.replace(before, after, 1))


def test_another_program_reads_every_pose(mission):
    for track, mark in zip(mission.tracks, read(mission)[0], strict=True):
        items = [item for part in mark.kml_geometry.tracks for item in part.track_items]
        times = [item.when.dt.timestamp() for item in items]
        for field, theirs, off in (
            ("times_s", times, 1e-6),
            ("latlon", [(item.coord.y, item.coord.x) for item in items], 1e-9),
            ("height_m", [item.coord.z for item in items], 1e-3),
        ):
            ours = np.concatenate([getattr(part, field) for part in track.poses()])
            np.testing.assert_allclose(theirs, np.nan_to_num(ours), atol=off, rtol=0)


def test_tracks_have_the_names_colours_and_widths_that_people_set(mission):
    first, second, third = mission.tracks
    look = TrackLook("Team <2>", "#12ab34", 6.5, hidden=True)
    root = check_kml(written(replace(mission, tracks=(replace(first, look=look), second, third))))
    lines = {style.get("id"): style.find(f"{KML}LineStyle") for style in root.iter(f"{KML}Style")}
    marks = {mark.get("id"): mark for mark in root.iter(f"{KML}Placemark")}
    shown = [
        (
            marks[f"t-{id}"].findtext(f"{KML}visibility"),
            lines[f"track-{id}"].findtext(f"{KML}color"),
            lines[f"track-{id}"].findtext(f"{KML}width"),
        )
        for id in (1, 2)
    ]
    assert marks["t-1"].findtext(f"{KML}name") == "Team <2>"
    assert shown == [("0", "ff34ab12", "6.5"), (None, "ff009fe6", "3.5")]


def test_objects_have_spans_facts_and_styles(mission):
    for found, mark in zip(mission.objects(), read(mission)[1], strict=True):
        assert (mark.geometry.y, mark.geometry.x) == tuple(found.latlon)
        assert mark.begin.dt.timestamp() == pytest.approx(found.first_time_s)
        assert mark.end.dt.timestamp() == pytest.approx(found.last_time_s)
        facts = {data.name: data.value for data in mark.extended_data.elements}
        assert facts["class"] == found.kind.replace("\x07", "?") and mark.style_url.url.startswith("#kind-")
        assert ("confidence" in facts) == (found.confidence is not None)


def test_a_new_part_begins_where_time_does_not_go_on(poses, track):
    jumbled = poses(12)
    times = jumbled.times_s.copy()
    times[4], times[9] = times[0], times[8]
    jumbled = make_poses(times, jumbled.latlon)
    root = check_kml(written(MissionExport("m", (track(jumbled, size=6),), (), list)))
    counts = [len(part.findall(f"{KML}when")) for part in root.iter(f"{GX}Track")]
    assert counts == [4, 2, 3, 3]


def test_headings_are_written_where_all_of_a_part_are_known(poses, track):
    for whole, expected in ((True, 9), (False, 0)):
        data = written(MissionExport("m", (track(poses(9, whole=whole), size=9),), (), list))
        assert data.count(b"<gx:angles>") == expected


def test_a_network_link_refreshes():
    data = format_network_link("Search <1>", href="https://e.example/m/x/export.kmz?a=1&b=2", refresh_s=5)
    check_kml(data)
    link = fastkml.KML.from_string(data.decode()).features[0]
    assert link.name == "Search <1>"
    assert link.link.href == "https://e.example/m/x/export.kmz?a=1&b=2"
    assert (link.link.refresh_mode.value, link.link.refresh_interval) == ("onInterval", 5.0)
