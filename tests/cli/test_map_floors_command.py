"""`expmap map floors`: floors listed, added and removed, in a folder and in a library."""

import json
import shutil

import pytest
from PIL import Image

from webapp.cli.localize import answer_text
from webapp.core.geo.floors import Floor
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.files.maps.folder import read_map
from webapp.store.library import open_library
from webapp.store.schema import Account
from webapp.tasks.maps import adopt_map


@pytest.fixture
def cfg(tmp_path, make_map):
    """A map of three photos in a separate folder."""
    cfg = make_map(tmp_path / "there", 3)
    for number in range(3):
        Image.new("RGB", (12, 8), (80 * number, 0, 0)).save(cfg.parent / "photos" / f"{number}.jpg")
    return cfg


@pytest.fixture
def plan(tmp_path):
    Image.new("RGB", (10, 20), "red").save(tmp_path / "first.png")
    return tmp_path / "first.png"


def first_floor(cfg):
    return next(floor for floor in read_map(cfg).floors if floor.id == 1)


def test_a_floor_is_added_to_a_folder_listed_and_removed(expmap, cfg, plan):
    before = cfg.read_bytes()
    assert expmap("map", "floors", cfg)[1].startswith("the map has only one image")
    code, out, _ = expmap(
        "map", "floors", cfg, "--add", "1st floor", "--level", "1", "--height", "4.5", "--image", plan
    )
    image = read_map(cfg).satellite
    assert code == 0
    assert out.splitlines() == [
        "1  1st floor     4.5 m  0 photos  first.png",
        f"0  Ground floor         3 photos  {image.path}",
    ]
    laid = first_floor(cfg).image.map_from_image
    assert laid == (image.width / 10, 0.0, 0.0, 0.0, image.height / 20, 0.0)
    assert (cfg.parent / "first.png").read_bytes() == plan.read_bytes()
    assert cfg.read_bytes() == before
    assert "first.png" not in expmap("map", "check", cfg)[1]

    known = json.loads(cfg.with_name("map.json").read_text())
    first = read_map(cfg).experiences[0]
    known["experiences"] = [{"id": first.id, "photo": first.photo, "floor": 1}]
    cfg.with_name("map.json").write_text(json.dumps(known))
    found = json.loads(expmap("map", "floors", cfg, "--json")[1])["floors"]
    assert [(one["name"], one["photos"]) for one in found] == [("Ground floor", 2), ("1st floor", 1)]
    assert found[0]["image"] is None
    code, _, err = expmap("map", "floors", cfg, "--remove", "1")
    assert code != 0 and "1 photos are on this floor" in err
    assert expmap("map", "floors", cfg, "--remove", "1st floor", "--tray")[0] == 0
    the_map = read_map(cfg)
    assert (the_map.floors, len(the_map.experiences), len(the_map.unplaced)) == ((), 2, 1)


def test_a_plan_that_is_gone_is_found_by_the_linter(expmap, cfg, plan):
    expmap("map", "floors", cfg, "--add", "Attic", "--level", "2", "--image", plan)
    (cfg.parent / "first.png").unlink()
    code, out, _ = expmap("map", "check", cfg)
    assert code == 3 and "missing-floor-image" in out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--add", "Attic"], "must be used together"),
        (["--height", "3"], "can only be used with --add"),
        (["--remove", "Attic"], "no floor 'Attic'"),
        (["--add", "Attic", "--level", "0"], "same level"),
    ],
)
def test_what_cannot_be_is_refused(expmap, cfg, options, said):
    before = sorted(path.name for path in cfg.parent.iterdir())
    code, _, err = expmap("map", "floors", cfg, *options)
    assert code == 2 and said in err
    assert sorted(path.name for path in cfg.parent.iterdir()) == before


def test_in_a_library_it_is_an_edit(expmap, cfg, plan, tmp_path):
    library = open_library(tmp_path / "library")
    shutil.copytree(cfg.parent, library.folder / "park")
    with library.database.write() as session:
        owner = Account(name="owner", is_owner=True)
        session.add(owner)
        session.flush()
        owner_id = owner.id
    adopt_map.adopt_map(library, "park", account_id=owner_id)
    library.database.close()
    there = library.folder / "park" / "map.cfg"
    assert expmap("map", "floors", there, "--add", "Attic", "--level", "2", "--image", plan)[0] == 0
    assert [floor.name for floor in read_map(there).floors] == ["Ground floor", "Attic"]
    assert plan.exists()
    assert expmap("map", "floors", there, "--remove", "Attic")[0] == 0
    assert read_map(there).floors == ()


def test_answers_in_the_terminal_name_the_floor():
    place = Hypothesis(1, "position", MapPixel(3, 4), 0.9, 2.0, 90.0, (1,), 30, 40, floor=1)
    counts = MatchStatistics(0, 0, 0, None, None, None, None)
    floors = (Floor(0, "Ground floor", 0.0), Floor(1, "Gallery", 1.0))
    answer = Answer((place,), 0.1, 0.0, None, counts)
    text = answer_text(answer, query="q.jpg", georeference=None, floors=floors)
    assert text.splitlines()[1].split()[:2] == ["probability", "floor"]
    assert "Gallery" in text.splitlines()[2]
    assert "floor" not in answer_text(answer, query="q.jpg", georeference=None)
