"""`expmap map print`: files of the right format and size, and errors with hints."""

import json

from PIL import Image

from webapp.files.maps.folder import read_map


def test_a_map_is_printed_as_png_and_pdf(expmap, make_map, tmp_path):
    cfg, png, pdf = make_map(tmp_path, 3), tmp_path / "sheet.png", tmp_path / "sheet.PDF"
    x, y = read_map(cfg).experiences[0].position
    answer = {"query": "q.jpg", "hypotheses": [{"x_px": x, "y_px": y, "probability": 0.9}]}
    answers = tmp_path / "answers.json"
    answers.write_text(json.dumps([answer, {"query": "broken.jpg", "error": "damaged"}]))
    options = ("--paper", "a3", "--orientation", "landscape", "--dpi", 50, "--answers", answers)
    code, out, err = expmap("map", "print", cfg, png, *options)
    assert (code, out) == (0, f"{png}\n"), err
    with Image.open(png) as image:
        assert image.size == (827, 585)
        assert round(image.info["dpi"][0]) == 50
    assert expmap("map", "print", cfg, pdf, "--labels", "names", "--no-headings")[0] == 0
    assert pdf.read_bytes().startswith(b"%PDF-")


def test_another_ending_and_a_file_without_answers_are_refused(expmap, make_map, tmp_path):
    cfg = make_map(tmp_path, 1)
    code, _, err = expmap("map", "print", cfg, tmp_path / "sheet.svg")
    assert code == 2
    assert ".pdf or .png" in err
    answers = tmp_path / "answers.json"
    answers.write_text('{"maps": []}')
    code, _, err = expmap("map", "print", cfg, tmp_path / "sheet.pdf", "--answers", answers)
    assert code == 2
    assert "the file does not contain answers" in err
    assert not (tmp_path / "sheet.pdf").exists()


def test_a_map_whose_image_is_missing_is_not_printed(expmap, make_map, tmp_path):
    cfg = make_map(tmp_path, 1)
    (tmp_path / read_map(cfg).satellite.path).unlink()
    code, _, err = expmap("map", "print", cfg, tmp_path / "sheet.pdf")
    assert code != 0
    assert read_map(cfg).satellite.path in err


def test_one_floor_and_all_of_them_exclude_each_other(expmap, make_map, tmp_path):
    cfg, pdf = make_map(tmp_path, 1), tmp_path / "sheet.pdf"
    assert expmap("map", "print", cfg, pdf, "--all-floors")[0] == 0
    assert pdf.read_bytes().count(b"/Type /Page\n") == 1
    code, _, err = expmap("map", "print", cfg, tmp_path / "sheet.png", "--all-floors")
    assert code == 2
    assert "only a PDF has several pages" in err
    code, _, err = expmap("map", "print", cfg, pdf, "--all-floors", "--floor", "1")
    assert code == 2
    assert "cannot be used together" in err
