"""`expmap map cut-video` for people and scripts."""

import json

import numpy as np
import pytest

from tests.video_clips import gps5, pan, write_clip

GPX = """<gpx version="1.1" creator="-" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="50.0" lon="14.0"><time>2026-05-01T10:00:00Z</time></trkpt>
<trkpt lat="50.001" lon="14.0"><time>2026-05-01T10:00:10Z</time></trkpt></trkseg></trk></gpx>"""


@pytest.fixture
def clip(tmp_path):
    pytest.importorskip("av")
    packets = [gps5([(50.0 + 1e-4 * second, 14.0)]) for second in range(10)]
    return write_clip(tmp_path / "a.mp4", pan(np.arange(0, 960, 8)), packets=packets)


def test_the_photos_make_a_map(expmap, clip, tmp_path):
    code, out, _ = expmap("map", "cut-video", clip, "-o", tmp_path / "out", "--json")
    assert code == 0
    report = json.loads(out)
    assert report["with_position"] == len(report["photos"]) > 6
    cfg = tmp_path / "out" / "map.cfg"
    assert expmap("map", "from-photos", tmp_path / "out", "-o", cfg, "--blank")[0] == 0
    assert len(cfg.read_text().splitlines()) == len(report["photos"]) + 1


def test_people_read_how_many_photos_there_are_and_what_was_left_out(expmap, clip, tmp_path):
    code, out, err = expmap("map", "cut-video", clip, "-o", tmp_path / "out", "--most", 2)
    assert (code, out) == (0, f"{tmp_path / 'out'}: 2 photos, 2 with a position\n")
    assert "the rest is left out" in err


def test_mistakes_are_explained(expmap, clip, tmp_path):
    (tmp_path / "t.gpx").write_text(GPX)
    for options, expected, words in (
        (["--starts", "yesterday"], 2, "is not a time"),
        (["--track", tmp_path / "t.gpx"], 1, "does not say when it began"),
        (["--track", clip], 2, "SRT or a GPX"),
    ):
        code, _, err = expmap("map", "cut-video", clip, "-o", tmp_path / "out", *options)
        assert code == expected
        assert words in err
