"""Zips of maps, and lists of positions, that name few things very often, or hold much more than their bytes.

All are derived from the random generator that is passed in: the same seed gives the same bytes.
"""

from __future__ import annotations

import functools
import io
import json
import random
import zipfile
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any

from PIL import Image

_PLAN = (400, 300)
_PHOTO = "photos/p.jpg"


def crowded_zip(chance: random.Random) -> bytes:
    """Make a zip of a map of a random one of `KINDS`."""
    return KINDS[chance.choice(sorted(KINDS))](chance)


def crowded_list(chance: random.Random) -> tuple[str, bytes]:
    """Make a list of positions that is long in an unusual way; return its name and content."""
    many = chance.choice((300, 30_000))
    texts: Mapping[str, Callable[[], str]] = {
        "digits.csv": lambda: f"name;x;y\na.jpg;{'1' * many}a;1\n",
        "names.csv": lambda: "name;x;y\n" + "".join(f"{n}/a.jpg;1;1\n" for n in range(many)),
        "folders.csv": lambda: "name;x;y\n" + "/".join("a" * many) + ".jpg;1;1\n",
        "empty.json": lambda: '{"features":[' + "{}," * (many * 50) + "{}]}",
        "deep.json": lambda: '{"features":' + "[" * many * 10,
        "number.json": lambda: '{"features":' + "1" * many + "}",
        "repeated.kml": lambda: (
            "<kml>"
            + "<Placemark><name>a.jpg</name><Point><coordinates>1,2</coordinates></Point></Placemark>" * many
            + "</kml>"
        ),
    }
    name = chance.choice(sorted(texts))
    return name, texts[name]().encode()


def _zip(parts: Mapping[str, bytes], *, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in {"plan.png": _picture(*_PLAN, "PNG"), **parts}.items():
            # photos are stored, as their ratio would be refused
            how = zipfile.ZIP_STORED if name.endswith((".jpg", ".png")) else method
            archive.writestr(zipfile.ZipInfo(name), data, compress_type=how)  # no timestamp
    return file.getvalue()


def _cfg(*photos: str) -> bytes:
    lines = [f"{n};{photo};{n % _PLAN[0]};{n % _PLAN[1]}\n" for n, photo in enumerate(photos)]
    return f"plan.png;{_PLAN[0]};{_PLAN[1]}\n{''.join(lines)}".encode()


@functools.cache
def _picture(width: int, height: int, kind: str) -> bytes:
    file = io.BytesIO()
    Image.new("L", (width, height)).save(file, kind)
    return file.getvalue()


def _one_photo(chance: random.Random) -> bytes:
    lines = chance.choice((40, 8000))
    side = chance.choice((800, 6000))
    return _zip({"map.cfg": _cfg(*[_PHOTO] * lines), _PHOTO: _picture(side, side, "JPEG")})


def _one_photo_in_many_spellings(chance: random.Random) -> bytes:
    names = [
        "./" * (n % 50) + _PHOTO.replace("/", "/" * (1 + n % 7)) for n in range(chance.choice((40, 2000)))
    ]
    return _zip({"map.cfg": _cfg(*names), _PHOTO: _picture(6000, 6000, "JPEG")})


def _many_large_photos(chance: random.Random) -> bytes:
    names = [f"photos/{n}.png" for n in range(chance.choice((2, 20)))]
    picture = _picture(7000, 7000, "PNG")
    return _zip({"map.cfg": _cfg(*names), **dict.fromkeys(names, picture)})


def _overlapping(chance: random.Random) -> bytes:
    names = [f"photos/{n}.jpg" for n in range(chance.choice((2, 2000)))]
    file = io.BytesIO(_zip({"map.cfg": _cfg(*names), names[0]: _picture(4000, 4000, "JPEG")}))
    with zipfile.ZipFile(file, "a") as archive:
        first = archive.getinfo(names[0])
        for name in names[1:]:
            again = copy(first)
            again.filename = name
            archive.filelist.append(again)
        archive.writestr(zipfile.ZipInfo("end.jpg"), b"")
    return file.getvalue()


def _small_files_that_grow(chance: random.Random) -> bytes:
    method = chance.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    names = [f"photos/{n}.bmp" for n in range(chance.choice((2, 60)))]
    return _zip({"map.cfg": _cfg(*names), **dict.fromkeys(names, bytes(900_000))}, method=method)


def _similar_names(chance: random.Random) -> bytes:
    number = chance.choice((10, 120))
    missing, there = ([f"{'a' * 80}{end}{'b' * n}.jpg" for n in range(number)] for end in "cd")
    return _zip({"map.cfg": _cfg(*missing), **dict.fromkeys(there, b"x")})


def _zip_in_zip(chance: random.Random) -> bytes:
    inner = _zip({"map.cfg": _cfg(_PHOTO)})
    for _ in range(chance.choice((1, 8))):
        inner = _zip({"map.cfg": _cfg(), "map.zip": inner, "unplaced/map.zip": inner})
    return inner


def _many_placements(chance: random.Random) -> bytes:
    cfg = _cfg(*[_PHOTO] * chance.choice((10, 2000)))
    names = [f"p{n}" for n in range(chance.choice((3, 250)))]
    return _zip(
        {
            "map.cfg": cfg,
            "map.json": _json(placements=[{"name": name} for name in names]),
            **{f"{name}.cfg": cfg if chance.random() < 0.05 else _cfg(_PHOTO) for name in names},
        }
    )


def _long_lists(chance: random.Random) -> bytes:
    number = chance.choice((600, 20_000))
    box = {"x": 0, "y": 0, "width": 1, "height": 1}
    click = {"x": 0.5, "y": 0.5}
    parts: dict[str, list[Any]] = {
        "experiences": [{"id": 0, "photo": _PHOTO, "blurred": [box] * number}],
        "notes": [{"id": n, "title": "x", "photos": [0] * 10} for n in range(number)],
        "control_points": [{"name": f"{n}", "photos": [{"id": 0, **click}]} for n in range(number)],
        "unplaced": [{"id": n, "photo": f"{n}.jpg"} for n in range(number)],
        "floors": [{"id": n, "name": f"{n}", "level": n} for n in range(min(number, 2000))],
    }
    part = chance.choice(sorted(parts))
    about = _json(**{part: parts[part]})
    return _zip({"map.cfg": _cfg(_PHOTO), _PHOTO: _picture(800, 600, "JPEG"), "map.json": about})


def _odd_json(chance: random.Random) -> bytes:
    head = b'{"format": "experience-map", "version": 1, "notes": '
    many = chance.choice((5000, 300_000))
    tail = chance.choice((b"[" * many, b"1" * many, b"[" + b"{}," * many + b"{}]}", b'[{"id":1}' * many))
    return _zip({"map.cfg": _cfg(), "map.json": head + tail})


def _json(**parts: Any) -> bytes:
    return json.dumps({"format": "experience-map", "version": 1, **parts}).encode()


KINDS: Mapping[str, Callable[[random.Random], bytes]] = {
    "one photo": _one_photo,
    "one photo in many spellings": _one_photo_in_many_spellings,
    "large photos": _many_large_photos,
    "overlap": _overlapping,
    "growing files": _small_files_that_grow,
    "similar names": _similar_names,
    "zip in zip": _zip_in_zip,
    "placements": _many_placements,
    "long lists": _long_lists,
    "odd json": _odd_json,
}
"""What makes a zip, by what it has too much of."""
