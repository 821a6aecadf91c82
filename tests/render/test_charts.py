import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from webapp.core.evaluation.metrics import ReliabilityBin
from webapp.render.charts import HEIGHT, WIDTH, error_chart, reliability_chart


def curve(svg: str) -> list[tuple[float, float]]:
    path = next(e for e in ET.fromstring(svg).iter("path") if e.get("class") == "curve")
    return [(float(x), float(y)) for x, y in re.findall(r"H([\d.]+)V([\d.]+)", path.get("d", ""))]


def test_error_curve_steps_at_each_error_on_a_logarithmic_axis() -> None:
    points = curve(error_chart(np.array([1.0, 10.0, 100.0, np.inf]), place_radius_px=20))
    xs, ys = zip(*points, strict=True)
    assert xs[1] - xs[0] == pytest.approx(xs[2] - xs[1], abs=0.2)
    assert ys[0] - ys[1] == pytest.approx(ys[1] - ys[2], abs=0.2)
    # 75 % at the end: the query without a hypothesis is never reached.
    plot = HEIGHT - 14 - 48
    assert ys[2] == pytest.approx(HEIGHT - 48 - 0.75 * plot, abs=0.2)


@pytest.mark.parametrize("errors", [[], [np.inf], [0.0, 0.0], [1e7]])
def test_error_curve_of_odd_data_is_valid(errors: list[float]) -> None:
    root = ET.fromstring(error_chart(np.array(errors), place_radius_px=20))
    assert root.get("role") == "img"
    assert root.get("aria-label")
    assert all(0 <= x <= WIDTH and 0 <= y <= HEIGHT for x, y in curve(ET.tostring(root, encoding="unicode")))


@pytest.mark.parametrize(("radius", "side"), [(2, "note"), (76, "note end")])
def test_the_name_of_the_place_radius_is_where_there_is_room(radius: float, side: str) -> None:
    root = ET.fromstring(error_chart(np.array([1.0]), place_radius_px=radius))
    assert [part.get("class") for part in root.iter() if part.text == "place radius"] == [side]


def test_reliability_has_a_dot_a_bin_at_its_place() -> None:
    svg = reliability_chart([ReliabilityBin(0.0, 1.0, 9), ReliabilityBin(1.0, 0.0, 9)])
    dots = [(float(e.get("cx", "")), float(e.get("cy", ""))) for e in ET.fromstring(svg).iter("circle")]
    assert dots == [(64.0, 14.0), (WIDTH - 28.0, HEIGHT - 48.0)]
    assert "9 queries: 0% stated, 100% right" in svg


def test_reliability_of_nothing_is_an_empty_chart() -> None:
    assert not list(ET.fromstring(reliability_chart([])).iter("circle"))
