import numpy as np
import pytest

from webapp.render.canvas import Canvas, plain, shortened, text_width

RED = (255, 0, 0)


@pytest.fixture
def canvas() -> Canvas:
    return Canvas(np.zeros((60, 80, 3), np.uint8))


def test_disc_covers_its_centre_and_ends_at_its_radius(canvas: Canvas) -> None:
    canvas.disc((40, 30), 10, colour=RED)
    assert tuple(canvas.pixels[30, 40]) == RED
    assert tuple(canvas.pixels[30, 48]) == RED
    assert not canvas.pixels[30, 53].any()


def test_ring_is_hollow_and_smooth(canvas: Canvas) -> None:
    canvas.ring((40, 30), 10, colour=RED, width=2)
    assert tuple(canvas.pixels[30, 50]) == RED
    assert not canvas.pixels[30, 40].any()
    # the full area of the line: circumference times width
    assert canvas.pixels[..., 0].sum() / 255 == pytest.approx(2 * np.pi * 10 * 2, rel=0.01)


@pytest.mark.parametrize("centre", [(-500.0, 30.0), (40.0, 9e9), (79.5, 59.5)])
def test_shapes_outside_do_no_harm(canvas: Canvas, centre: tuple[float, float]) -> None:
    canvas.ring(centre, 5, colour=RED)
    canvas.disc(centre, 5, colour=RED)
    canvas.line(centre, (10, 10), colour=RED)
    assert canvas.size == (80, 60)


def test_faint_drawing_shines_through(canvas: Canvas) -> None:
    with canvas.faint(0.25):
        canvas.disc((40, 30), 10, colour=(200, 100, 0))
    assert tuple(canvas.pixels[30, 40]) == (50, 25, 0)


def test_text_changes_pixels_where_it_stands(canvas: Canvas) -> None:
    canvas.text((10, 40), "Hello", size=20, colour=RED)
    assert canvas.pixels[20:45, 10:60, 0].max() == 255
    assert not canvas.pixels[:15].any()


def test_letters_that_the_font_lacks_are_written_without_accents() -> None:
    assert plain("Příliš žluťoučký 90 ° · …") == "Prilis zlutoucky 90 ° · …"
    assert plain("公園.jpg") == "??.jpg"


def test_long_names_keep_their_end() -> None:
    name = "a/very/long/path/" * 10 + "photo.jpg"
    cut = shortened(name, 16, width=200)
    assert cut.startswith("…") and cut.endswith("photo.jpg")
    assert text_width(cut, 16) <= 200
    assert shortened("photo.jpg", 16, width=200) == "photo.jpg"
