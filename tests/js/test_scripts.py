"""The unit tests of the pages' scripts, run by node."""

import json
import random
import shutil
import subprocess

import pytest

from webapp.core.geo.grids import degrees_minutes_seconds, mgrs, utm
from webapp.core.geo.types import LatLon

LONGEST_S = 120

WRITE_GRIDS = """
import { dmsText, mgrsText, utmOf } from "%s";
const places = JSON.parse(await new Response(process.stdin).text());
console.log(JSON.stringify(places.map((place) => [utmOf(place), mgrsText(place), dmsText(place)])));
"""

needs_node = pytest.mark.skipif(
    shutil.which("node") is None, reason="node is not installed: apt install nodejs"
)


@needs_node
def test_modules(request):
    files = sorted(str(path) for path in request.path.parent.glob("*.test.mjs"))
    assert len(files) >= 5
    answer = subprocess.run(
        ["node", "--test", *files], capture_output=True, text=True, timeout=LONGEST_S, check=False
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr


@needs_node
def test_grids_agree_with_proj(request):
    """UTM in the browser is that of PROJ, which the server uses, to a millimetre."""
    rng = random.Random(7)
    places = [LatLon(rng.uniform(-80, 84), rng.uniform(-180, 180)) for _ in range(2000)]
    places += [LatLon(rng.uniform(55, 84), rng.uniform(0, 43)) for _ in range(1000)]  # Norway, Svalbard
    module = request.path.parents[2] / "static/js/shared/map/grids.js"
    answer = subprocess.run(
        ["node", "--input-type=module", "-e", WRITE_GRIDS % module.as_uri()],
        input=json.dumps(places),
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    same_square = 0
    for place, (found, square, dms) in zip(places, json.loads(answer.stdout), strict=True):
        expected = utm(place)
        assert (found["zone"], found["band"]) == (expected.zone, expected.band)
        assert found["easting"] == pytest.approx(expected.easting, abs=0.0011)
        assert found["northing"] == pytest.approx(expected.northing, abs=0.0011)
        assert dms == degrees_minutes_seconds(place)
        same_square += square == mgrs(place)
    assert same_square >= len(places) - 10  # a millimetre may be across a grid line
