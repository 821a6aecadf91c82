"""Positions in the subtitles of drones."""

from datetime import datetime

import pytest

from webapp.errors import TrackError
from webapp.files.video.subtitles import read_subtitles

NEW = """1
00:00:00,000 --> 00:00:00,033
<font size="28">SrtCnt : 1, DiffTime : 33ms
2026-05-01 12:00:00.250
[iso : 100] [shutter : 1/500.0] [latitude: 50.2045] [longitude: 15.8291] [rel_alt: 30.0] </font>

2
00:00:01,500 --> 00:00:01,533
<font size="28">SrtCnt : 2, DiffTime : 33ms
2026-05-01 12:00:01.750
[latitude : -50.2046] [longtitude : -15.8292] </font>
"""
OLD = """1
00:01:00,000 --> 00:01:01,000
HOME(14.1000,50.1000) 2017.08.05 14:11:51
GPS(14.2500,50.1250,19) BAROMETER:1.9
"""


@pytest.mark.parametrize(
    ("text", "times", "places"),
    [
        (NEW, [0.0, 1.5], [[50.2045, 15.8291], [-50.2046, -15.8292]]),
        (OLD, [60.0], [[50.125, 14.25]]),
    ],
)
def test_positions_of_both_forms_are_read(tmp_path, text, times, places):
    (tmp_path / "a.SRT").write_text(text)
    track = read_subtitles(tmp_path / "a.SRT").track
    assert track.times_s.tolist() == times
    assert track.latlon.tolist() == places


def test_the_clock_of_the_drone_is_that_of_the_first_cue(tmp_path):
    (tmp_path / "a.srt").write_text(NEW)
    assert read_subtitles(tmp_path / "a.srt").clock == datetime(2026, 5, 1, 12, 0, 0, 250_000)


@pytest.mark.parametrize("text", ["", "a film\n", NEW.replace("50.2045", "0").replace("15.8291", "0")[:300]])
def test_subtitles_without_positions_are_refused(tmp_path, text):
    (tmp_path / "a.srt").write_text(text)
    with pytest.raises(TrackError, match="no position"):
        read_subtitles(tmp_path / "a.srt")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrackError, match="cannot be read"):
        read_subtitles(tmp_path / "a.srt")
