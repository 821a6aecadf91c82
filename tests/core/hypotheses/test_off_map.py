"""One rule decides for all output whether an answer means "not on this map"."""

import pytest

from webapp.core.hypotheses.model import is_off_map


@pytest.mark.parametrize(
    ("best", "off", "expected"),
    [
        (None, None, True),
        (None, 0.0, True),
        (0.1, None, False),
        (0.5, 0.4, False),
        (0.5, 0.5, False),
        (0.4, 0.5, True),
    ],
)
def test_an_answer_is_off_the_map_where_that_is_more_probable_than_its_first_place(best, off, expected):
    assert is_off_map(best, off) is expected
