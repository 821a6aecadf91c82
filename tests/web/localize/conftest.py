"""The sample map in a library, with its index built once for all tests of this folder."""

import io
import shutil
from pathlib import Path

import pytest

from webapp.store.schema import MapRecord
from webapp.tasks.maps import adopt_map

SLUG = "sample"


@pytest.fixture
def sample(library, owner, ready_sample):
    """The id of the sample map, ready to answer."""
    shutil.copytree(ready_sample, library.map_folder(SLUG))
    return adopt_map.adopt_map(library, SLUG, account_id=owner.id)


@pytest.fixture
def queries(sample_folder):
    """The folder with the sample's queries."""
    return sample_folder / "queries"


@pytest.fixture
def ask():
    """Localize photos, as a browser does."""

    def run(browser, *photos, slug=SLUG, **options):
        files = [(io.BytesIO(p.read_bytes()), p.name) if isinstance(p, Path) else p for p in photos]
        fields = {**options, **({"file": files} if files else {})}
        return browser.post(f"/api/v1/maps/{slug}/localize", data=fields, content_type="multipart/form-data")

    return run


@pytest.fixture
def record(library, sample):
    """Read the record of the sample map."""

    def read():
        with library.database.read() as session:
            return session.get_one(MapRecord, sample)

    return read
