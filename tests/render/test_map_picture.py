from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.render.colours import EXPERIENCE, TRUTH, probability_colour
from webapp.render.map_picture import (
    BAND_PX,
    DISC_PX,
    MapView,
    detail,
    draw_map,
    headline,
    overview,
    scale_bar,
)

STATISTICS = MatchStatistics(100, 80, 50, 0.1, 0.9, 0.4, 32.0)


def a_map(width: int = 1000, height: int = 800) -> Map:
    corners = [(0.1, 0.1), (0.9, 0.9), (0.1, 0.9), (0.9, 0.1), (0.5, 0.2)]
    places = [MapPixel(x * width, y * height) for x, y in corners]
    return Map(
        SatelliteImage("plan.png", width, height),
        tuple(Experience(i, f"{i}.jpg", place) for i, place in enumerate(places)),
    )


def answer(*hypotheses: Hypothesis, off: float | None = 0.1) -> Answer:
    return Answer(hypotheses, off, 0.0, None if hypotheses else NoPose("too few matches"), STATISTICS)


def at(x: float, y: float, **changes: object) -> Hypothesis:
    found = Hypothesis(1, "position", MapPixel(x, y), 0.9, None, None, (0,), 20, 40)
    return replace(found, **changes)


def draw(themap: Map, result: Answer, truth: MapPixel | None = None) -> tuple[np.ndarray, MapView]:
    """Draw a picture, and find the whole map in it."""
    image = themap.satellite
    drawn = np.array(
        draw_map(np.full((image.height, image.width, 3), 128, np.uint8), themap, answer=result, truth=truth)
    )
    marked = [h.position for h in result.hypotheses] + ([truth] if truth else [])
    part = overview(themap, marked)
    wide = part.right - part.left > 2 * (part.bottom - part.top)
    sizes = {(True, True): (1600, 620), (True, False): (1112, 1100)}
    return drawn, part.fitted(sizes.get((bool(result.hypotheses), wide), (1600, 1100)))


def pixel(
    drawn: np.ndarray, view: MapView, position: MapPixel, dx: float = 0, dy: float = 0
) -> tuple[int, ...]:
    x, y = view.shown(position)
    return tuple(int(v) for v in drawn[round(y + dy), round(x + dx)])


@pytest.mark.parametrize("size", [(1000, 800), (2040, 200), (300, 1200), (60, 50), (5000, 4000)])
def test_every_experience_is_a_dot_of_one_colour(size: tuple[int, int]) -> None:
    themap = a_map(*size)
    drawn, view = draw(themap, answer(at(size[0] / 2, size[1] / 2)))
    for experience in themap.experiences:
        assert pixel(drawn, view, experience.position) == EXPERIENCE


@pytest.mark.parametrize("probability", [0.0, 0.35, 1.0])
def test_hypothesis_has_the_colour_of_its_probability(probability: float) -> None:
    found = at(500, 500, probability=probability)
    drawn, view = draw(a_map(), answer(found))
    assert pixel(drawn, view, found.position, dx=-9) == probability_colour(probability)


def test_radius_is_a_circle_of_that_size() -> None:
    found = at(500, 500, radius_px=60.0)
    drawn, view = draw(a_map(), answer(found))
    colour = np.array(probability_colour(0.9))
    reach = 60 * view.scale
    assert np.abs(np.array(pixel(drawn, view, found.position, dx=reach)) - colour).max() < 60
    inside, outside = (np.array(pixel(drawn, view, found.position, dx=f * reach)) for f in (0.8, 1.2))
    assert np.abs(inside - outside).max() > 10
    assert (outside == 128).all()


@pytest.mark.parametrize(
    ("heading", "direction"), [(0, (0, -1)), (90, (1, 0)), (180, (0, 1)), (270, (-1, 0))]
)
def test_heading_is_clockwise_from_up(heading: float, direction: tuple[int, int]) -> None:
    found = at(500, 500, heading_deg=heading)
    drawn, view = draw(a_map(), answer(found))
    reach = 1.8 * DISC_PX
    dx, dy = direction
    assert pixel(drawn, view, found.position, dx=dx * reach, dy=dy * reach) == probability_colour(0.9)
    assert pixel(drawn, view, found.position, dx=-dx * reach, dy=-dy * reach) == (128, 128, 128)


def test_heading_follows_north_of_a_turned_map() -> None:
    # North is to the left in the image: heading north points left.
    turned = Georeference("EPSG:32633", (0.0, -0.5, 500_000, -0.5, 0.0, 5_500_000, 0, 0, 1), "affine")
    themap = replace(a_map(), georeference=turned)
    found = at(500, 500, heading_deg=0.0)
    drawn, view = draw(themap, answer(found))
    assert pixel(drawn, view, found.position, dx=-1.8 * DISC_PX) == probability_colour(0.9)


def test_truth_is_marked_and_seen_behind_a_right_hypothesis() -> None:
    alone, view = draw(a_map(), answer(at(200, 200)), MapPixel(700, 500))
    assert pixel(alone, view, MapPixel(700, 500)) == TRUTH
    covered, view = draw(a_map(), answer(at(500, 500)), MapPixel(500, 500))
    assert pixel(covered, view, MapPixel(500, 500), dx=14, dy=14) == TRUTH


def test_better_hypothesis_lies_on_top() -> None:
    best, other = at(500, 500, probability=0.8), at(503, 500, rank=2, probability=0.1)
    drawn, view = draw(a_map(), answer(best, other))
    assert pixel(drawn, view, best.position, dx=9) == probability_colour(0.8)


def test_without_a_hypothesis_there_is_the_map_and_no_detail() -> None:
    drawn, view = draw(a_map(), answer(off=1.0))
    assert drawn.shape == (view.size[1] + BAND_PX, max(view.size[0], 1040), 3)


def test_map_without_photos_can_be_drawn() -> None:
    empty = Map(SatelliteImage("plan.png", 500, 400), ())
    drawn, view = draw(empty, answer(off=1.0))
    assert (view.left, view.top, view.right, view.bottom) == (0, 0, 500, 400)
    assert (drawn[10, 10] == 128).all()


def test_image_of_another_size_than_stated_is_stretched() -> None:
    themap = a_map(1000, 800)
    satellite = np.zeros((400, 500, 3), np.uint8)
    satellite[:, 250:] = 200
    drawn = np.array(draw_map(satellite, themap, answer=answer(off=1.0)))
    view = overview(themap, []).fitted((1600, 1100))
    assert pixel(drawn, view, MapPixel(480, 500)) == (0, 0, 0)
    assert pixel(drawn, view, MapPixel(520, 500)) == (200, 200, 200)


def test_view_holds_all_that_matters_and_little_else() -> None:
    themap = replace(a_map(4000, 3000), experiences=a_map(1000, 800).experiences)
    view = overview(themap, [MapPixel(1500, 700)])
    assert view.left <= 100 and view.right >= 1500
    assert view.right < 2000 and view.bottom < 1300


def test_truth_off_the_image_does_not_break_the_view() -> None:
    drawn, view = draw(a_map(), answer(at(500, 500)), MapPixel(-900, 5000))
    assert (view.left, view.bottom) == (0, 800)
    assert drawn.shape[0] > BAND_PX


def test_detail_is_three_times_larger_and_inside_the_image() -> None:
    themap = a_map(2000, 1600)
    whole = overview(themap, []).fitted((1100, 1100))
    close = detail(themap, whole, centre=MapPixel(5, 5), size=(480, 800))
    assert close.scale == pytest.approx(3 * whole.scale, rel=0.02)
    assert (close.left, close.top) == (0, 0)


def test_scale_bar_is_round_and_true() -> None:
    length, label = scale_bar(a_map(), MapView(0, 0, 1000, 800, 1.5))
    assert (length, label) == (75.0, "50 map pixels")
    metric = Georeference("EPSG:32633", (0.5, 0, 500_000, 0, -0.5, 5_500_000, 0, 0, 1), "affine")
    length, label = scale_bar(replace(a_map(), georeference=metric), MapView(0, 0, 1000, 800, 1.5))
    assert label == "20 m"
    assert length == pytest.approx(60, rel=1e-3)


def test_headline_says_what_the_colours_say() -> None:
    two = answer(at(1, 1, probability=0.7), at(2, 2, rank=2, probability=0.15), off=0.15)
    assert headline(two) == "Place 1: 70 %,  2: 15 %  ·  not on this map: 15 %"
    assert headline(answer(at(1, 1, probability=0.3), off=0.7)).startswith("Probably not on this map")
    assert headline(answer(off=1.0)) == "No place found: too few matches  ·  not on this map: 100 %"
    cut = replace(answer(at(1, 1, probability=0.996), off=None), other_probability=0.004)
    assert headline(cut) == "Place 1: over 99 %  ·  places not shown: under 1 %"
