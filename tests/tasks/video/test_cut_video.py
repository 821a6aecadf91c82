"""Photos of videos: their times and positions, and what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest

from tests.files.video.test_subtitles import NEW
from tests.video_clips import gps5, klv, pan, write_clip, write_stream
from webapp.errors import Cancelled, MissingPart, PhotoError
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.video.cut_video import CutVideoOptions, cut_video

POSITIONS = np.arange(0, 960, 8)
STARTS = {"creation_time": "2026-05-01T10:00:00Z"}
GPX = """<gpx version="1.1" creator="-" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="50.0" lon="14.0"><time>2026-05-01T10:00:00Z</time></trkpt>
<trkpt lat="50.001" lon="14.0"><time>2026-05-01T10:00:10Z</time></trkpt></trkseg></trk></gpx>"""


@pytest.fixture(autouse=True)
def needs_av():
    pytest.importorskip("av")


def cut(clip, out, **options):
    given = CutVideoOptions(**options)
    done = cut_video(clip, out, options=given, limits=PhotoLimits(), progress=Progress())
    return done, [read_facts(out / name, limits=PhotoLimits()) for name in done.photos]


def northings(facts):
    """Metres north of 50 degrees."""
    return [round((one.gps.lat - 50.0) * 111_320, 1) for one in facts]


def test_photos_have_the_time_of_their_frame(tmp_path):
    clip = write_clip(tmp_path / "walk.mp4", pan(POSITIONS), metadata=STARTS)
    done, facts = cut(clip, tmp_path / "out", fov_deg=70.0)
    assert 8 <= len(facts) <= 16
    for name, one in zip(done.photos, facts, strict=True):
        seconds = int(name.removeprefix("walk_").removesuffix(".jpg")) / 1000
        assert one.taken_at.startswith(f"2026-05-01T10:00:{int(seconds):02}")
        assert one.fov_deg == pytest.approx(70.0, abs=1.5)
        assert (one.width, one.height) == (320, 240)
    assert done.with_position == 0


@pytest.mark.parametrize(
    "begins", ["9999-12-31T23:59:59-0800", "9999-12-31T23:59:59Z", "2026-05-01T10:00:00+9959"]
)
def test_an_absurd_time_is_none(tmp_path, begins):
    metadata = {"com.apple.quicktime.creationdate": begins}
    clip = write_clip(tmp_path / "a.mov", pan(POSITIONS), metadata=metadata)
    done, facts = cut(clip, tmp_path / "out")
    assert {one.taken_at for one in facts} == {None}
    clip.with_suffix(".srt").write_text(NEW.replace("2026-05-01 12:00", "9999-12-31 23:59"))
    done, facts = cut(clip, tmp_path / "captioned")
    assert {one.taken_at for one in facts} == {None}
    assert done.with_position > 0
    clip.with_suffix(".srt").unlink()
    done, facts = cut(clip, tmp_path / "stated", starts_s=1_700_000_000.0)
    assert facts[0].taken_at.startswith("2023-11-14T") and ":13:20" in facts[0].taken_at


def test_a_gopro_has_its_positions_in_the_video(tmp_path):
    packets = [gps5([(50.0 + 1e-4 * (second + n / 4), 14.0) for n in range(4)]) for second in range(10)]
    clip = write_clip(tmp_path / "a.mp4", pan(POSITIONS), packets=packets)
    done, facts = cut(clip, tmp_path / "out")
    seconds = [int(name[2:-4]) / 1000 for name in done.photos]
    assert done.with_position == len(facts) > 6
    assert northings(facts) == pytest.approx([11.132 * at for at in seconds], abs=0.3)


def test_a_drone_has_them_in_subtitles_of_the_same_name(tmp_path):
    clip = write_clip(tmp_path / "DJI_0001.MP4", pan(POSITIONS))
    (tmp_path / "DJI_0001.SRT").write_text(NEW.replace("-50.2046", "50.2046").replace("-15.8292", "15.8292"))
    done, facts = cut(clip, tmp_path / "out")
    assert facts[0].gps.lat == pytest.approx(50.2045, abs=2e-5)
    assert facts[0].taken_at.startswith("2026-05-01T12:00:0")
    assert done.with_position < len(facts), "the subtitles end before the video"


def test_a_track_is_joined_by_time(tmp_path):
    clip = write_clip(tmp_path / "a.mp4", pan(POSITIONS), metadata=STARTS)
    (tmp_path / "a.gpx").write_text(GPX)
    done, facts = cut(clip, tmp_path / "out", track=tmp_path / "a.gpx")
    seconds = [int(name[2:-4]) / 1000 for name in done.photos]
    assert northings(facts) == pytest.approx([11.132 * at for at in seconds], abs=0.3)


def test_a_stopped_run_is_repeated_with_the_same_photos(tmp_path):
    clip = write_clip(tmp_path / "a.mp4", pan(POSITIONS))
    whole, _ = cut(clip, tmp_path / "whole")

    class Stopped(Progress):
        left = 30

        def cancelled(self):
            self.left -= 1
            return self.left < 0

    with pytest.raises(Cancelled):
        cut_video(clip, tmp_path / "out", options=CutVideoOptions(), limits=PhotoLimits(), progress=Stopped())
    first = {path.name for path in (tmp_path / "out").iterdir()}
    assert 0 < len(first) < len(whole.photos)
    again, _ = cut(clip, tmp_path / "out")
    assert (again.photos, again.notes) == (whole.photos, ())
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(whole.photos)


def test_photos_of_another_run_are_mentioned(tmp_path):
    clip = write_clip(tmp_path / "a.mp4", pan(POSITIONS))
    cut(clip, tmp_path / "out", spread=0.1)
    done, _ = cut(clip, tmp_path / "out", spread=0.5)
    assert "from the same video, cut otherwise before" in done.notes[0]


def test_a_damaged_video_gives_what_comes_before(tmp_path):
    clip = write_clip(tmp_path / "a.avi", pan(POSITIONS))
    whole, _ = cut(clip, tmp_path / "whole")
    clip.write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    part, _ = cut(clip, tmp_path / "part")
    assert part.photos
    assert {*part.photos[:-1]} <= {*whole.photos}


def test_frames_that_become_too_large_end_it(tmp_path):
    """In a stream the header of each part counts."""
    parts = []
    for number, size in enumerate([(320, 240), (1280, 960)]):
        part = tmp_path / f"{number}.ts"
        write_stream(part, pan(POSITIONS[:24]), size=size, first=24 * number)
        parts.append(part.read_bytes())
    clip = tmp_path / "a.mts"
    clip.write_bytes(b"".join(parts))
    limits = PhotoLimits(max_megapixels=0.5)
    done = cut_video(clip, tmp_path / "out", options=CutVideoOptions(), limits=limits, progress=Progress())
    assert {read_facts(tmp_path / "out" / name, limits=limits).width for name in done.photos} == {320}
    assert done.notes == ("its frames have 1 megapixels, more than 0.5",)


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"not a video" * 100)
    with pytest.raises(PhotoError, match="not a video"):
        cut(tmp_path / "a.mp4", tmp_path / "out")
    clip = write_clip(tmp_path / "b.mp4", pan(POSITIONS[:20]))
    limits = replace(PhotoLimits(), max_megapixels=0.05)
    with pytest.raises(PhotoError, match="megapixels"):
        cut_video(clip, tmp_path / "out", options=CutVideoOptions(), limits=limits, progress=Progress())
    damaged = [klv("DEVC", "\0", b"GPS5l\x14\x00\x09")]
    clip = write_clip(tmp_path / "c.mp4", pan(POSITIONS[:20]), packets=damaged)
    with pytest.raises(PhotoError, match="telemetry"):
        cut(clip, tmp_path / "out")


def test_without_the_extra_its_command_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    with pytest.raises(MissingPart, match="photos from videos") as raised:
        cut(tmp_path / "a.mp4", tmp_path / "out")
    assert "experience-map[video]" in raised.value.hint
