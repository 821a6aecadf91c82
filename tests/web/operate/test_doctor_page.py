"""The owner's page of checks: what needs something done comes first."""

import shutil

from webapp.tasks.maps import adopt_map
from webapp.web.operate.doctor import LABELS


def test_the_owner_sees_what_to_do_first(client, library, owner, make_map):
    make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    shutil.rmtree(library.map_folder("park"))
    page = client.get("/server/check").text
    assert page.index('data-check="maps" data-state="failing"') < page.index('data-state="ok"')
    assert "1 of 1 maps have lost their folder, such as park" in page
    assert 'data-check="database" data-state="ok"' in page
    assert 'href="/server/check"' in client.get("/").text
    assert page.count("data-check=") >= 12 and str(LABELS["permissions"]) in page


def test_others_do_not(sign_in, new_account):
    client = sign_in(new_account("Eva"))
    assert client.get("/server/check").status_code == 403
    assert "/server/check" not in client.get("/").text
