"""The parameters of localization can be varied by name."""

import pytest

from webapp.core.tuning import DEFAULT, field_names, with_field


def test_every_number_has_a_name_and_can_be_set():
    names = [*field_names(DEFAULT)]
    assert {"retrieval.shortlist", "pose.level.roll_sigma", "pose.annealing.rounds"} <= set(names)
    for name in names:
        assert with_field(DEFAULT, name, text="7") != DEFAULT


def test_a_number_keeps_its_type_and_the_default_stays():
    changed = with_field(DEFAULT, "pose.level.roll_sigma", text="0.5")
    assert changed.pose.level.roll_sigma == 0.5
    assert changed.pose.level.pitch_sigma == DEFAULT.pose.level.pitch_sigma
    assert DEFAULT.pose.level.roll_sigma != 0.5
    assert with_field(DEFAULT, "retrieval.shortlist", text="20").retrieval.shortlist == 20


@pytest.mark.parametrize("name", ["pose", "pose.none", "none.starts", "pose.starts.more", ""])
def test_an_unknown_field_is_rejected_with_the_known_ones(name):
    with pytest.raises(KeyError, match="known: "):
        with_field(DEFAULT, name, text="1")


def test_what_is_no_number_is_rejected():
    with pytest.raises(ValueError, match="many"):
        with_field(DEFAULT, "retrieval.shortlist", text="many")
