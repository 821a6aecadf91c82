"""Symbols of objects by class, and all lines within their box."""

import pytest

from webapp.missions.core.trajectory.symbols import (
    DISC,
    HAZARD,
    HELP,
    PEOPLE,
    SIDE,
    SYMBOLS,
    THING,
    kind_colour,
    svg_path,
    symbol_of,
)


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        ("victim", PEOPLE),
        ("Person", PEOPLE),
        ("fire extinguisher", HELP),
        ("fire", HAZARD),
        ("gas leak", HAZARD),
        ("first aid", HELP),
        ("parked car", THING),
        ("backpack", THING),
        ("radioactive", HAZARD),
        ("radioactive source", HAZARD),
        ("flammable", HAZARD),
        ("gasoline", HAZARD),
        ("gas_leak", HAZARD),
        ("medical waste", HAZARD),
        ("Fires", HAZARD),
        ("fire in building", HAZARD),
        ("collapsed stairs", HAZARD),
        ("body of water", HAZARD),
        ("firefighter", PEOPLE),
        ("fire fighter", PEOPLE),
        ("person in water", PEOPLE),
        ("driver", PEOPLE),
        ("casualties", PEOPLE),
        ("women", PEOPLE),
        ("children", PEOPLE),
        ("person_2", PEOPLE),
        ("fire exit", HELP),
        ("fire hydrant", HELP),
        ("screwdriver", HELP),
        ("screw driver", HELP),
        ("radio", HELP),
        ("medical kit", HELP),
        ("stairs", HELP),
        ("waterproof bag", THING),
        ("street sign", THING),
        ("fire truck", THING),
        ("buses", THING),
        ("boxes", THING),
    ],
)
def test_the_frame_says_what_an_object_means(kind, frame):
    assert symbol_of(kind).frame is frame
    assert kind_colour(kind) == frame.fill


@pytest.mark.parametrize(
    "kind", ["x", "", "carpet", "Ω", "manual", "stool", "theater", "radiator", "water bottle"]
)
def test_other_classes_have_no_symbol_and_no_colour_of_one(kind):
    assert symbol_of(kind) is None
    assert kind_colour(kind) not in {symbol.frame.fill for symbol in SYMBOLS}


def test_all_lines_are_in_the_box():
    lines = [DISC, *(line for s in SYMBOLS for line in (s.frame.outline, *s.glyph))]
    assert all(0 < x < SIDE and 0 < y < SIDE for line in lines for x, y in line)


def test_a_path_of_lines():
    assert svg_path((((1, 2), (3, 4.5)), ((0, 0), (1, 1)))) == "M1 2L3 4.5M0 0L1 1"
    assert svg_path((((1, 2), (3, 4)),), closed=True) == "M1 2L3 4Z"
