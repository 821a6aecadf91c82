import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from webapp.render.report import QueryPictures, figures, number, percent, render_report
from webapp.tasks.evaluation.types import Evaluation

VOID = {"meta", "img", "path", "circle", "br", "link"}


class Page(HTMLParser):
    """Checks the nesting of elements, and collects the resources that the page would load."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.text: list[str] = []
        self.tags: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def report(evaluation: Evaluation) -> str:
    worst = [
        QueryPictures(evaluation.rows[1], b"\xff\xd8map", b"\xff\xd8match"),
        QueryPictures(evaluation.rows[0], b"\xff\xd8", None),
    ]
    return render_report(evaluation, worst=worst)


def test_page_is_whole_and_loads_nothing(evaluation: Evaluation) -> None:
    html = report(evaluation)
    page = Page(html)
    assert page.open == []
    assert len(page.loads) == 3
    assert all(address.startswith("data:image/jpeg;base64,") for address in page.loads)
    assert "://" not in html
    assert "url(" not in html
    assert "@import" not in html


def test_page_works_in_light_and_dark_and_on_a_phone(evaluation: Evaluation) -> None:
    html = report(evaluation)
    assert "prefers-color-scheme: dark" in html
    assert 'name="viewport"' in html
    assert '<html lang="en">' in html


def test_names_are_text_and_never_markup(evaluation: Evaluation) -> None:
    html = report(evaluation)
    page = Page(html)
    assert "script" not in page.tags
    assert "<script>.jpg" in page.text
    assert "the file is <b>no</b> photo" in page.text


def test_every_query_has_its_line(evaluation: Evaluation) -> None:
    html = report(evaluation)
    body = re.findall(r'<th scope="row">([^<]*)</th>\n<td', html)
    assert body == ["a &amp; b.jpg", "q1.jpg", "q2.jpg", "&lt;script&gt;.jpg"]


def columns(line: str) -> int:
    cells = re.findall(r"<t[hd]([^>]*)>", line)
    return sum(int(m.group(1)) if (m := re.search(r'colspan="(\d+)"', cell)) else 1 for cell in cells)


@pytest.mark.parametrize("fixture", ["evaluation", "georeferenced"])
def test_table_has_as_many_cells_in_every_line(fixture: str, request: pytest.FixtureRequest) -> None:
    html = report(request.getfixturevalue(fixture))
    table = html[html.index('<table class="queries">') :]
    lines = [columns(line) for line in re.findall(r"<tr>(.*?)</tr>", table[: table.index("</table>")], re.S)]
    first, second, *body = lines
    through_both_heads = table[: table.index("<tbody>")].count('rowspan="2"')
    assert set(body) == {first} == {second + through_both_heads}


def test_metres_stand_only_where_they_are_known(evaluation: Evaluation, georeferenced: Evaluation) -> None:
    assert "200 px off" in report(evaluation)
    assert "200 px (100.0 m) off" in report(georeferenced)


def test_says_how_the_photos_were_hidden(evaluation: Evaluation) -> None:
    hidden = replace(evaluation, scheme="leave-one-place-out", hide_within_px=35.0)
    assert "within 35 px hidden" in report(hidden)
    assert "each hidden while it was asked for" in report(replace(evaluation, scheme="leave-one-out"))


def test_figures_have_the_names_of_the_json(evaluation: Evaluation) -> None:
    by_name = {figure.name: figure for figure in figures(evaluation)}
    assert by_name["within_10px"].value == "25.0 %"
    assert by_name["median_px"].value == "102.5 px"
    assert by_name["calibration_seconds"].value == "–"
    assert by_name["index_bytes"].value == "5.0 MB"
    assert by_name["failed"].value == "1"
    assert " to " in by_name["within_10px"].interval


def test_unknown_is_a_dash() -> None:
    assert (number(None), number(float("nan")), percent(None)) == ("–", "–", "–")
    assert (number(1.25, 2), percent(0.5)) == ("1.25", "50.0 %")
