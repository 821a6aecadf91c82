"""Permanent deletion of maps in the bin."""


def test_only_what_is_in_the_bin_is_deleted_and_then_it_is_gone(client, library, park):
    folder = library.map_folder(park)
    folder.mkdir()
    (folder / "map.cfg").write_text("plan.png;10;10\n")
    assert client.delete(f"/api/v1/maps/{park}?forever=true").status_code == 409
    assert folder.is_dir()
    client.delete(f"/api/v1/maps/{park}")
    assert client.delete(f"/api/v1/maps/{park}?forever=true").status_code == 200
    assert not folder.exists()
    assert client.delete(f"/api/v1/maps/{park}?forever=true").status_code == 404


def test_only_owners_delete(library, owner, new_account, new_map, sign_in):
    editor = new_account("editor")
    slug = new_map(owner, shared={editor: "editor"})
    sign_in(owner).delete(f"/api/v1/maps/{slug}")
    assert sign_in(editor).delete(f"/api/v1/maps/{slug}?forever=true").status_code == 403
    assert sign_in(new_account("eve")).delete(f"/api/v1/maps/{slug}?forever=true").status_code == 404
    assert "Park" in sign_in(owner).get("/bin").text


def test_a_new_map_gets_the_name_of_a_deleted_one_that_a_job_still_wrote_for(client, library, park):
    for path in (park, f"{park}?forever=true"):
        assert client.delete(f"/api/v1/maps/{path}").status_code == 200
    late = library.map_folder(park) / "derived" / "export.lock"
    late.parent.mkdir(parents=True)
    late.touch()
    assert client.post("/api/v1/maps", json={"name": "Park"}).json["slug"] == park
    assert not late.exists()
