"""Reads a folder of loggers' files, and compares each with an independent reading of the same file.

GPX is read by gpxpy, other formats by a few lines here. Compares the number of positions, each position, and
the first and the last time. Differences need to be judged: a file may be unusual on purpose.

    python -m benchmarks.logger_files FOLDER
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import struct
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import gpxpy
import numpy as np

from webapp.errors import ExpMapError
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.tasks.place_track import ReadOptions
from webapp.missions.tasks.read_track import ReadReport, read_track

Row = tuple[float, float, float | None]
"""Latitude, longitude, seconds since 1970."""

_SEMICIRCLES = 180.0 / 2**31
_FIT_EPOCH_S = 631_065_600
_SAME_DEG = 2e-6
_SAME_S = 1.0
_SOON_S = 1e5
"""Smaller times are those of untimed tracks, which count from 0."""


def _gpx(path: Path) -> Iterator[Row]:
    found = gpxpy.parse(path.read_text(encoding="utf-8"))
    lines = [segment.points for track in found.tracks for segment in track.segments]
    for point in [*(p for line in lines for p in line), *(p for r in found.routes for p in r.points)]:
        yield point.latitude, point.longitude, point.time.timestamp() if point.time else None


def _tcx(path: Path) -> Iterator[Row]:
    text = path.read_text(encoding="utf-8")
    for point in re.findall(r"<Trackpoint>.*?</Trackpoint>", text, re.DOTALL):
        place = [re.search(rf"<{name}Degrees>([^<]*)", point) for name in ("Latitude", "Longitude")]
        when = re.search(r"<Time>([^<]*)", point)
        if all(place):
            time = datetime.fromisoformat(when[1]).timestamp() if when else None
            yield float(place[0][1]), float(place[1][1]), time


def _igc(path: Path) -> Iterator[Row]:
    text = path.read_text(encoding="latin-1")
    day = re.search(r"HFDTE(?:DATE:)?(\d{6})", text)
    assert day is not None
    for line in re.findall(r"^B\d{13}.*$", text, re.MULTILINE):
        lat, lon = (int(line[7:9]) + int(line[9:14]) / 6e4), (int(line[15:18]) + int(line[18:23]) / 6e4)
        time = datetime.strptime(day[1] + line[1:7], "%d%m%y%H%M%S").replace(tzinfo=UTC)
        yield lat * (-1 if line[14] == "S" else 1), lon * (-1 if line[23] == "W" else 1), time.timestamp()


def _fit(path: Path) -> Iterator[Row]:
    """Read the records of a little-endian FIT file."""
    data = path.read_bytes()
    at, end = data[0], data[0] + struct.unpack_from("<I", data, 4)[0]
    known: dict[int, tuple[int, list[tuple[int, int]]]] = {}
    while at < end:
        head = data[at]
        at += 1
        if head & 0x40 and not head & 0x80:
            number, count = struct.unpack_from("<HB", data, at + 2)
            fields = [(data[at + 5 + 3 * i], data[at + 6 + 3 * i]) for i in range(count)]
            at += 5 + 3 * count
            known[head & 15] = (number, fields)
            continue
        number, fields = known[(head >> 5) & 3 if head & 0x80 else head & 15]
        values = {}
        for field, size in fields:
            values[field] = data[at : at + size]
            at += size
        if number == 20 and 0 in values and values[0] != b"\xff\xff\xff\x7f":
            lat, lon = (struct.unpack("<i", values[field])[0] * _SEMICIRCLES for field in (0, 1))
            yield lat, lon, float(struct.unpack("<I", values[253])[0] + _FIT_EPOCH_S)


def _kml(path: Path) -> Iterator[Row]:
    root = ElementTree.parse(path).getroot()
    for element in root.iter():
        name = element.tag.rsplit("}", 1)[-1]
        if name == "LineString":
            text = next((c.text or "" for c in element if c.tag.endswith("coordinates")), "")
            for word in text.split():
                lon, lat = map(float, word.split(",")[:2])
                yield lat, lon, None
        elif name == "Track":
            whens = [c.text or "" for c in element if c.tag.endswith("when")]
            coords = [(c.text or "").split() for c in element if c.tag.endswith("coord")]
            for when, place in zip(whens, coords, strict=False):
                if len(place) >= 2:
                    yield float(place[1]), float(place[0]), datetime.fromisoformat(when).timestamp()


def _geojson(path: Path) -> Iterator[Row]:
    for feature in json.loads(path.read_text(encoding="utf-8"))["features"]:
        geometry = feature["geometry"]
        lines = geometry["coordinates"] if geometry["type"] == "MultiLineString" else []
        lines = [geometry["coordinates"]] if geometry["type"] == "LineString" else lines
        for line in lines:
            for place in line:
                yield place[1], place[0], None


def _csv(path: Path) -> Iterator[Row]:
    text = path.read_text(encoding="utf-8", errors="replace")
    dialect = "\t" if "\t" in text.splitlines()[0] else "|" if "|" in text.splitlines()[0] else ","
    for row in csv.DictReader(text.splitlines(), delimiter=dialect, skipinitialspace=True):
        cells = {
            (key or "").strip().lower(): value or "" for key, value in row.items() if isinstance(value, str)
        }
        if cells.get("valid", "").lower() == "no fix":
            continue
        lat, lon = (_angle(cells, name) for name in (("latitude", "lat", "n/s"), ("longitude", "lon", "e/w")))
        day = cells.get("date") or cells.get("utc_d")
        clock = cells.get("time") or cells.get("utc_t")
        time = None
        if day and clock:
            stamp = f"{day.replace('/', '-')}T{clock}+00:00"
            time = datetime.fromisoformat(stamp).timestamp()
        yield lat, lon, time


def _angle(cells: dict[str, str], names: tuple[str, str, str]) -> float:
    text = cells.get(names[0]) or cells[names[1]]
    parts = [float(part) for part in re.findall(r"[\d.]+", text)]
    size = sum(part / 60**place for place, part in enumerate(parts))
    negative = "-" in text or re.search("[SW]", text + cells.get(names[2], ""))
    return -size if negative else size


READERS: dict[str, Callable[[Path], Iterator[Row]]] = {
    "GPX": _gpx,
    "TCX": _tcx,
    "IGC": _igc,
    "FIT": _fit,
    "KML": _kml,
    "GeoJSON": _geojson,
    "table": _csv,
}


def _differences(report: ReadReport, rows: list[Row]) -> list[str]:
    """List differences between a report and an independent reading, except items reported as left out."""
    latlon = np.concatenate([track.poses.latlon for track in report.tracks] or [np.zeros((0, 2))])
    left_out = sum(
        one.count for one in report.skipped if one.reason.startswith(("points without a time", "lines"))
    )
    found = []
    if len(latlon) + left_out != len(rows) and len(latlon) != len(rows):
        found.append(f"{len(latlon)} positions of {len(rows)}")
    places = {(round(lat, 5), round(lon, 5)) for lat, lon, _ in rows}
    strange = sum((round(lat, 5), round(lon, 5)) not in places for lat, lon in latlon.tolist())
    if strange and not _near(latlon, rows):
        found.append(f"{strange} positions that are not in it")
    times = [time for _, _, time in rows if time is not None]
    mine = [t for track, timed in _timed(report, bool(times)) if timed for t in track.poses.times_s[[0, -1]]]
    if times and mine and not (min(times) - _SAME_S <= min(mine) and max(mine) <= max(times) + _SAME_S):
        found.append("other times")
    if times and not mine:
        found.append("no times")
    return found


def _near(latlon: np.ndarray, rows: list[Row]) -> bool:
    known = np.array([(lat, lon) for lat, lon, _ in rows])
    return all(np.abs(known - place).max(axis=1).min() < _SAME_DEG for place in latlon)


def _timed(report: ReadReport, known: bool) -> Iterator[tuple[object, bool]]:
    for track in report.tracks:
        yield track, known and bool(track.poses.times_s[0] > _SOON_S)


def main() -> int:
    """Print a line for each file, and the numbers of exact, refused and different files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    options = replace(ReadOptions(), min_move=MinMove(0.0))
    counts: Counter[str] = Counter()
    for path in sorted(parser.parse_args().folder.iterdir()):
        try:
            report = read_track(path, options=options)
        except ExpMapError as error:
            counts["refused in a sentence"] += 1
            print(f"{path.name}: refused: {str(error)[:150]}")
            continue
        poses = sum(len(track.poses) for track in report.tracks)
        said = f"{poses} poses, {len(report.sightings)} objects"
        reader = READERS.get(report.kind)
        verdict = "read; nothing independent to compare with"
        if reader is not None and poses:
            try:
                different = _differences(report, list(reader(path)))
            except (ValueError, KeyError, LookupError, gpxpy.gpx.GPXException) as error:
                verdict = f"read; the independent reader fails ({type(error).__name__})"
            else:
                verdict = f"DIFFERENT: {', '.join(different)}" if different else "exact"
        counts[verdict.split(":")[0].split(";")[0]] += 1
        print(f"{path.name}: {report.kind}: {said}: {verdict}")
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    return int(bool(counts["DIFFERENT"]))


if __name__ == "__main__":
    sys.exit(main())
