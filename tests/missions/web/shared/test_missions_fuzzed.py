"""Any request for data of missions is answered according to the OpenAPI document."""

import pytest
import schemathesis

from tests.web.test_openapi import CHECKS, cases, each
from webapp.store.accounts import accounts
from webapp.web.openapi import PATH

# schemathesis does not close answers that are files
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

MINE = (
    "/export.",
    "/objects.csv",
    "/link.kml",
    "/query",
    "/missions/{mission_id}/shares",
    "/shared-missions/",
)


@pytest.fixture
def asked(app, library, owner, client, new_mission, share, add_photo):
    """A shared mission: headers of its owner, and the ids of its content."""
    with library.database.write() as session:
        token = accounts.new_token(session, session.merge(owner), name="test")
    mission = new_mission()
    shared = share(mission, photos=True, public=True)
    ids = {
        "missions": [mission],
        "tracks": [client.get(f"/api/v1/missions/{mission}").json["tracks"][0]["id"]],
        "photos": [add_photo(mission)],
        "shared-missions": [shared["url"].rpartition("/")[2]],
        "shares": [shared["id"]],
        "objects": ["c1"],
    }
    return {"Authorization": f"Bearer {token}"}, ids


@pytest.mark.parametrize("part", MINE)
def test_answers_keep_to_the_document(app, asked, part):
    app.testing = False  # errors of the program give a response, as on the server
    headers, ids = asked
    schema = schemathesis.openapi.from_dict(app.test_client().get(PATH).json)
    schema.app = app
    found = [result.ok() for result in schema.get_all_operations()]
    seen = set()

    def call(case):
        seen.add(case.call_and_validate(headers=headers, checks=CHECKS).status_code)

    mine = [operation for operation in found if part in operation.path]
    for operation in sorted(mine, key=lambda operation: operation.method == "delete"):
        each(cases(operation, "", ids), examples=8, call=call)
    assert seen & {200, 201, 204}
