import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from webapp.render.colours import INK, luminance, probability_colour, text_on

# Machado, Oliveira, Fernandes 2009, full dichromacy, on linear RGB.
DEUTAN = np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]])
PROTAN = np.array([[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]])


def seen_luminance(colour: tuple[int, int, int], matrix: np.ndarray) -> float:
    linear = np.array([((v / 255 + 0.055) / 1.055) ** 2.4 if v > 10 else v / 255 / 12.92 for v in colour])
    return float(np.clip(matrix @ linear, 0, 1) @ (0.2126, 0.7152, 0.0722))


@given(st.floats(0, 1), st.floats(0, 1))
def test_more_probable_is_never_darker(a: float, b: float) -> None:
    low, high = sorted((a, b))
    # tolerance for rounding to 8 bits
    assert luminance(probability_colour(low)) <= luminance(probability_colour(high)) + 0.004


def test_brightness_grows_for_colour_blind_eyes_too() -> None:
    for matrix in (DEUTAN, PROTAN):
        seen = [seen_luminance(probability_colour(p), matrix) for p in np.linspace(0, 1, 11)]
        assert all(b > a for a, b in zip(seen, seen[1:], strict=False)), seen  # noqa: RUF007


def test_ends_and_clipping() -> None:
    assert probability_colour(0) == probability_colour(-1) == (68, 1, 84)
    assert probability_colour(1) == probability_colour(2) == (253, 231, 37)


def test_numbers_are_readable_on_every_colour() -> None:
    for p in np.linspace(0, 1, 21):
        ground = probability_colour(p)
        bright, dark = sorted((luminance(ground), luminance(text_on(ground))), reverse=True)
        assert (bright + 0.05) / (dark + 0.05) > 3.0
    assert text_on((255, 255, 255)) == INK
