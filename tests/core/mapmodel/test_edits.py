"""Edits of a map."""

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel import edits
from webapp.core.mapmodel.model import Experience, Map, Placement, SatelliteImage
from webapp.errors import UsageError

A = Experience(0, "a.jpg", MapPixel(1.0, 2.0), heading_deg=10.0)
B = Experience(3, "b.jpg", MapPixel(5.5, 6.0))
MAP = Map(
    SatelliteImage("s.png", 100, 50),
    (A, B),
    placements=(Placement("clusters", {0: MapPixel(9.0, 9.0), 3: MapPixel(8.0, 8.0)}),),
    next_id=7,
    revision=4,
)


def new(id: int, x: float = 1.0, y: float = 1.0, *, photo: str = "c.jpg") -> Experience:
    return Experience(id, photo, MapPixel(x, y))


def test_add_takes_new_ids_only() -> None:
    added = edits.add(MAP, [new(7), new(9)])
    assert [e.id for e in added.experiences] == [0, 3, 7, 9]
    assert (added.next_id, added.revision) == (10, 5)
    assert (MAP.next_id, len(MAP.experiences)) == (7, 2)


def test_an_id_is_never_used_again() -> None:
    emptied = edits.remove(edits.add(MAP, [new(7)]), [0, 3, 7])
    assert emptied.experiences == () and emptied.placements[0].positions == {}
    assert (emptied.next_id, emptied.revision) == (8, 6)
    with pytest.raises(UsageError, match="the id 7 is not free"):
        edits.add(emptied, [new(7)])


def test_place_moves_several_and_nothing_else() -> None:
    moved = edits.place(MAP, {3: MapPixel(100.0, 50.0), 0: MapPixel(0.0, 0.0)})
    assert [e.position for e in moved.experiences] == [MapPixel(0.0, 0.0), MapPixel(100.0, 50.0)]
    assert moved.experiences[0].heading_deg == 10.0
    assert moved.placements == MAP.placements and moved.next_id == 7 and moved.revision == 5


@given(st.floats(-1e9, 1e9))
def test_heading_is_kept_within_a_turn(heading_deg: float) -> None:
    kept = edits.set_heading(MAP, 3, heading_deg=heading_deg).experiences[1].heading_deg
    assert kept is not None and 0 <= kept < 360
    difference = math.radians(kept - heading_deg)
    assert math.cos(difference) == pytest.approx(1.0, abs=1e-6)


def test_heading_can_be_forgotten() -> None:
    turned = edits.set_heading(MAP, 0, heading_deg=None)
    assert turned.experiences[0].heading_deg is None and turned.revision == 5


def test_placement_is_added_and_replaced() -> None:
    replaced = edits.set_placement(MAP, Placement("clusters", {0: MapPixel(2.0, 2.0)}))
    both = edits.set_placement(replaced, Placement("other", {}))
    assert [(p.name, dict(p.positions)) for p in both.placements] == [
        ("clusters", {0: MapPixel(2.0, 2.0)}),
        ("other", {}),
    ]
    assert both.revision == 6


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda: edits.place(MAP, {1: MapPixel(1, 1)}), "no experience 1"),
        (lambda: edits.set_heading(MAP, 1, heading_deg=1.0), "no experience 1"),
        (lambda: edits.remove(MAP, [0, 1]), "no experience 1"),
        (lambda: edits.set_placement(MAP, Placement("x", {1: MapPixel(1, 1)})), "no experience 1"),
        (lambda: edits.place(MAP, {0: MapPixel(100.1, 1)}), "outside the image"),
        (lambda: edits.place(MAP, {0: MapPixel(1, -0.1)}), "outside the image"),
        (lambda: edits.place(MAP, {0: MapPixel(math.nan, 1)}), "outside the image"),
        (lambda: edits.set_placement(MAP, Placement("x", {0: MapPixel(1, 51)})), "outside the image"),
        (lambda: edits.add(MAP, [new(7, 1, 51)]), "outside the image"),
        (lambda: edits.add(MAP, [new(8), new(8)]), "the id 8 is not free"),
        (lambda: edits.add(MAP, [new(2)]), "the id 2 is not free"),
        (lambda: edits.add(MAP, [new(2**31)]), "not free"),
        (lambda: edits.add(MAP, [new(7, photo="../c.jpg")]), "can leave the map's folder"),
        (lambda: edits.set_heading(MAP, 0, heading_deg=math.inf), "inf is not a heading"),
    ],
)
def test_impossible_edits(edit: Callable[[], Map], words: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        edit()
    assert caught.value.hint
