"""A bucket, and the storages of several machines."""

import pytest

from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import ObjectCache
from webapp.files.object_storage.storage import ObjectStorage


@pytest.fixture
def bucket_name(s3):
    return s3.new_bucket()


@pytest.fixture
def node(s3, bucket_name, tmp_path):
    """Make the storage of a separate machine."""

    def make(name="one", *, limit=10**9, timeout_s=10.0, **options):
        bucket = Bucket(f"s3://{bucket_name}/some/prefix", timeout_s=timeout_s)
        return ObjectStorage(bucket, ObjectCache(tmp_path / f"cache-{name}", limit=limit, **options))

    return make
