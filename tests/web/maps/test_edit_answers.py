"""The response to an edit is about this edit only, whatever others do at the same time."""

import pytest

from webapp.store.maps import edits, maps
from webapp.store.schema import Photo
from webapp.tasks.maps import edit_map

IMAGE = {"satellite_path": "plan.png", "satellite_width": 100, "satellite_height": 80}


@pytest.fixture
def paper(library, owner, new_map):
    """A map with an image and two photos, which exist only in the database."""
    slug = new_map(owner, name="Paper")
    library.map_folder(slug).mkdir()
    (library.map_folder(slug) / "plan.png").write_bytes(b"only named here")
    with library.database.write() as session:
        record = maps.find(session, slug, account=owner)
        for n in range(2):
            photo = Photo(
                name=f"{n}.jpg", path=f"photos/{n}.jpg", sha256=str(n), size_bytes=1, width=4, height=3
            )
            maps.add_photo(session, record, row=photo)
        edits.apply(session, record, changes={"map": IMAGE}, kind="satellite", account_id=owner.id)
    return f"/api/v1/maps/{slug}"


def place(client, paper, id):
    wish = {"kind": "place", "changes": [{"id": id, "x_px": 5, "y_px": 6}]}
    return client.patch(f"{paper}/experiences", json=wish).json


def test_what_others_do_meanwhile_is_not_in_it(client, sign_in, owner, paper, monkeypatch):
    other, run = sign_in(owner), edit_map.edit_map
    before = client.get(paper).json["revision"]

    def second(*args, **options):
        monkeypatch.setattr(edit_map, "edit_map", run)
        place(other, paper, 1)
        return run(*args, **options)

    monkeypatch.setattr(edit_map, "edit_map", second)
    answer = place(client, paper, 0)
    assert (answer["revision"], [p["id"] for p in answer["photos"]]) == (before + 2, [0])


def test_an_edit_that_changes_nothing_has_no_revision(client, paper):
    assert place(client, paper, 0)["revision"] == client.get(paper).json["revision"]
    again = place(client, paper, 0)
    assert (again["revision"], again["photos"]) == (None, [])


def test_the_undo_of_an_image_returns_the_image(client, paper):
    assert "satellite" not in place(client, paper, 0)
    client.post(f"{paper}/undo")
    assert client.post(f"{paper}/undo").json["satellite"] is None
    assert client.post(f"{paper}/redo").json["satellite"]["width"] == 100
