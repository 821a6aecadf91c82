"""`docs/results.md` names every field of the JSON and every column of the CSV, and no other."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from webapp.core.hypotheses.model import CameraPose
from webapp.render.report import COLUMNS
from webapp.tasks.evaluation.evaluate import to_json

PAGE = (Path(__file__).parents[2] / "docs" / "results.md").read_text("utf-8")


def documented(title: str) -> set[str]:
    """Return the names that begin the lines of the lists below a heading."""
    section = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    rows = re.findall(r"^- (`.+?`): ", section, flags=re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`([^`]+)`", row)}


def flat(form: dict, inside: dict[str, str]) -> set[str]:
    """Return names of fields; for those in `inside`, also the inner names, with its prefix."""
    names = set()
    for key, value in form.items():
        prefix = inside.get(key)
        if prefix is None:
            names.add(key)
            continue
        inner = value[0] if isinstance(value, list) else value
        names |= {f"{prefix}{name}" for name in inner}
        names |= {key} if isinstance(value, list) else set()
    return names


@pytest.fixture
def form(evaluation):
    """Return the output of `evaluate --json`."""
    return to_json(evaluation)


def test_every_field_of_localize_is_explained(form):
    answer = form["per_query"][0]["answer"]
    inside = {"hypotheses": "hypotheses[].", "statistics": "statistics.", "seconds": "seconds."}
    only_sometimes = {"sequence", "note", "no_pose"}
    only_with_floors = {f"hypotheses[].{name}" for name in ("floor", "floor_name", "floor_height_m")}
    only_sometimes |= only_with_floors
    camera = {f.name for f in fields(CameraPose)} | {"height_m"}
    only_by_landmarks = {"hypotheses[].camera"} | {f"hypotheses[].camera.{name}" for name in camera}
    assert documented("`localize --json`") == flat(answer, inside) | only_sometimes | only_by_landmarks


def test_every_field_of_evaluate_is_explained(form):
    assert documented("`evaluate --json`") == flat(form, {"per_query": "per_query[]."})


def test_every_column_is_explained():
    assert documented("`results.csv`") == set(COLUMNS)
