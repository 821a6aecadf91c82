"""A bucket of an S3 server, accessed by boto3; a watcher may count the requests."""

from __future__ import annotations

import base64
import hashlib
import logging
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal, Protocol
from urllib.parse import urlsplit

from webapp.errors import (
    DiskFull,
    ExpMapError,
    ObjectLost,
    StorageError,
    StorageUnavailable,
    UsageError,
)
from webapp.extras import extra
from webapp.files.atomic import storage_error

_log = logging.getLogger(__name__)

_PIECE = 8 << 20
"""Bytes of a part: larger files are transferred in several parts in parallel."""

_AT_ONCE = 8

_BLOCK = 1 << 20

TIMEOUT_S = 10.0
"""Seconds without data until a request fails; after a second attempt the server counts as unreachable."""

PROBE_TIMEOUT_S = 2.0
"""The same for a probe of the server, which makes a single attempt."""

_WAIT_S = 5

_LOG_EVERY_S = 60.0

_REFUSED = frozenset({"AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "ExpiredToken", "403"})
_FULL = frozenset({"QuotaExceeded", "InsufficientStorage", "XMinioStorageFull", "InsufficientCapacity"})
_NO_OBJECT = frozenset({"NoSuchKey", "404"})
_NO_BUCKET = "NoSuchBucket"
_DAMAGED = "BadDigest"


@dataclass(frozen=True, slots=True)
class StoredObject:
    key: str  # Without the prefix
    bytes: int
    changed_at: datetime


class Bucket:
    """The objects below a prefix of a bucket.

    Args:
        url: `s3://bucket/prefix`; server and credentials are configured as usual for boto3:
            `AWS_ENDPOINT_URL`, `AWS_ACCESS_KEY_ID` and so on.
        timeout_s: Seconds without data until a request fails.

    Raises:
        UsageError: The address is malformed, or boto3 cannot use the configuration that it finds.
    """

    def __init__(self, url: str, *, timeout_s: float = TIMEOUT_S) -> None:
        parts = urlsplit(url)
        prefix = parts.path.strip("/")
        if parts.scheme != "s3" or not parts.netloc:
            raise UsageError(
                f"{url!r} is not an address of an object storage",
                where="EXPMAP_STORAGE",
                hint="write s3://bucket or s3://bucket/prefix",
            )
        self.url = url
        self._bucket = parts.netloc
        self._prefix = f"{prefix}/" if prefix else ""
        self._client, self._transfer = _connect(timeout_s)
        self._logged: dict[str, float] = {}
        self._logging = threading.Lock()
        self._probe = _connect(min(timeout_s, PROBE_TIMEOUT_S), attempts=1)[0]

    def put(self, key: str, file: Path) -> None:
        """Store a file; on return, the server has received all of it and checked its MD5.

        Raises:
            StorageUnavailable, DiskFull, StorageError: No part of the object becomes visible.
        """
        with self._asking("put", key), file.open("rb") as source:
            self._client.upload_fileobj(source, self._bucket, self._prefix + key, Config=self._transfer)

    def get(self, key: str, target: Path) -> None:
        """Download an object to a new file, which may remain, incomplete, after an error.

        Raises ObjectLost, StorageUnavailable, DiskFull, StorageError.
        """
        with self._asking("get", key):
            self._client.download_file(self._bucket, self._prefix + key, str(target), Config=self._transfer)

    def probe(self) -> None:
        """Send a minimal request to check that the server responds.

        Raises:
            StorageUnavailable, StorageError: It does not respond within `PROBE_TIMEOUT_S`, or refuses.
        """
        with self._asking("probe", self.url):
            self._probe.list_objects_v2(Bucket=self._bucket, Prefix=self._prefix, MaxKeys=1)

    def delete(self, key: str) -> None:
        with self._asking("delete", key):
            self._client.delete_object(Bucket=self._bucket, Key=self._prefix + key)

    def objects(self) -> Iterator[StoredObject]:
        """List all objects below the prefix. Raises StorageUnavailable, StorageError."""
        for page in self._pages("list_objects_v2"):
            for one in page.get("Contents", ()):
                key = one["Key"].removeprefix(self._prefix)
                yield StoredObject(key, one["Size"], one["LastModified"])

    def drop_unfinished(self, *, begun_before: datetime) -> int:
        """Abort unfinished multipart uploads that began before a time; return their number.

        Raises StorageUnavailable, StorageError.
        """
        dropped = 0
        for page in self._pages("list_multipart_uploads"):
            for one in page.get("Uploads", ()):
                if one["Initiated"] < begun_before:
                    with self._asking("delete", self.url):
                        self._client.abort_multipart_upload(
                            Bucket=self._bucket, Key=one["Key"], UploadId=one["UploadId"]
                        )
                    dropped += 1
        return dropped

    def _pages(self, operation: str) -> Iterator[dict[str, Any]]:
        """Yield the pages of a listing below the prefix."""
        pages = iter(self._client.get_paginator(operation).paginate(Bucket=self._bucket, Prefix=self._prefix))
        is_more = True
        while is_more:
            with self._asking("list", self.url):
                page: dict[str, Any] = next(pages, {})
            yield page
            is_more = page.get("IsTruncated", False)

    @contextmanager
    def _asking(self, operation: Operation, key: str) -> Iterator[None]:
        """Count a request; convert its errors to those of the program, and log them."""
        try:
            with asking(operation), self._translated(key):
                yield
        except ObjectLost:
            raise  # not logged: whether that is an error is up to the caller
        except StorageError as error:
            self._log_seldom(error.message)
            raise

    def _log_seldom(self, message: str) -> None:
        """Log a message, but the same one at most every `_LOG_EVERY_S` seconds."""
        with self._logging:
            now = time.monotonic()
            if now < self._logged.get(message, -math.inf) + _LOG_EVERY_S:
                return
            self._logged[message] = now
        _log.warning("%s: %s", self.url, message)

    @contextmanager
    def _translated(self, key: str) -> Iterator[None]:
        with extra("cluster"):
            from boto3.exceptions import Boto3Error
            from botocore import exceptions

        try:
            yield
        except exceptions.ClientError as error:
            raise _refusal(error.response, key=key, url=self.url) from error
        except (exceptions.NoCredentialsError, exceptions.PartialCredentialsError) as error:
            raise StorageUnavailable(
                "there are no credentials for the object storage",
                wait_s=_WAIT_S,
                hint="set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
            ) from error
        except (exceptions.BotoCoreError, Boto3Error) as error:
            raise _away(error) from error
        except OSError as error:
            raise storage_error(error, where=str(error.filename or key)) from error


def _connect(timeout_s: float, *, attempts: int = 2) -> tuple[Any, Any]:
    """Create a boto3 client, which threads may share, and its configuration of file transfers."""
    with extra("cluster"):
        import boto3
        from boto3.s3.transfer import TransferConfig
        from botocore.config import Config
        from botocore.exceptions import BotoCoreError
    how = Config(
        connect_timeout=timeout_s,
        read_timeout=timeout_s,
        retries={"total_max_attempts": attempts, "mode": "standard"},
        max_pool_connections=4 * _AT_ONCE,
        request_checksum_calculation="when_required",  # not all S3-compatible servers support newer ones
        response_checksum_validation="when_required",
    )
    try:
        client = boto3.client("s3", config=how)
    except (BotoCoreError, ValueError) as error:
        raise UsageError(
            f"the object storage cannot be used: {error}",
            where="EXPMAP_STORAGE",
            hint="check AWS_ENDPOINT_URL and AWS_DEFAULT_REGION",
        ) from error
    for operation in ("PutObject", "UploadPart"):
        client.meta.events.register(f"before-parameter-build.s3.{operation}", _add_md5)
    transfer = TransferConfig(
        multipart_threshold=_PIECE,
        multipart_chunksize=_PIECE,
        max_concurrency=_AT_ONCE,
        num_download_attempts=2,
    )
    return client, transfer


def _add_md5(params: dict[str, Any], **_: Any) -> None:
    """Add the MD5 of a file or part to its request, so that the server refuses data damaged in transit."""
    body, digest = params["Body"], hashlib.md5(usedforsecurity=False)
    start = body.tell()
    while block := body.read(_BLOCK):
        digest.update(block)
    body.seek(start)
    params["ContentMD5"] = base64.b64encode(digest.digest()).decode("ascii")


def _away(error: Exception) -> StorageUnavailable:
    """Convert a connection error (of several attempts, the last one) to an error of the program."""
    with extra("cluster"):
        from botocore import exceptions

    last = getattr(error, "last_exception", error)
    if isinstance(last, exceptions.ReadTimeoutError | exceptions.ConnectTimeoutError | TimeoutError):
        return StorageUnavailable(
            "the object storage did not answer in time", wait_s=_WAIT_S, hint="try again in a moment"
        )
    broken = (
        exceptions.ConnectionClosedError,
        exceptions.IncompleteReadError,
        exceptions.ResponseStreamingError,
    )
    if isinstance(last, broken):
        return StorageUnavailable(
            "the connection to the object storage was lost", wait_s=_WAIT_S, hint="try again in a moment"
        )
    return StorageUnavailable(
        "the object storage cannot be reached", wait_s=_WAIT_S, hint="try again in a moment"
    )


def _refusal(response: dict[str, Any], *, key: str, url: str) -> ExpMapError:
    """Convert an error response of the server to an error of the program."""
    code = str(response.get("Error", {}).get("Code", ""))
    status = response.get("ResponseMetadata", {}).get("HTTPStatusCode", 0)
    if code == _NO_BUCKET:
        return StorageUnavailable(
            "the bucket of the object storage does not exist",
            wait_s=_WAIT_S,
            where=url,
            hint="ask the administrator of the server",
        )
    if code in _NO_OBJECT:
        return ObjectLost(
            "this file is missing from the object storage", where=key, hint="restore it from a backup"
        )
    if code == _DAMAGED:
        return StorageUnavailable(
            "the file was damaged on its way to the object storage",
            wait_s=_WAIT_S,
            where=key,
            hint="try again in a moment",
        )
    if code in _FULL or status == HTTPStatus.INSUFFICIENT_STORAGE:
        return DiskFull("the object storage is full", where=url, hint="ask the administrator of the server")
    if code in _REFUSED or status == HTTPStatus.FORBIDDEN:
        return StorageUnavailable(
            "the object storage refuses access", wait_s=_WAIT_S, hint="ask the administrator of the server"
        )
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status == HTTPStatus.TOO_MANY_REQUESTS:
        return StorageUnavailable(
            "the object storage is overloaded or out of order", wait_s=_WAIT_S, hint="try again in a moment"
        )
    return StorageError(f"the object storage refused the request: {code or status}", where=url)


Operation = Literal["get", "put", "delete", "list", "probe"]


class StorageWatcher(Protocol):
    """Counts requests and look-ups; called by any thread."""

    def asked(self, operation: Operation, seconds: float, *, failed: bool) -> None:
        """Record a request: for an object, possibly in several parts, or for a page of a listing."""

    def looked_up(self, *, found: bool) -> None:
        """Record a look-up of an object in the cache, and whether it was found."""


_watchers: list[StorageWatcher] = []
"""The watcher of this process, if any."""


def watch(watcher: StorageWatcher | None) -> None:
    """Report to this watcher from now on; None stops reporting."""
    _watchers[:] = [] if watcher is None else [watcher]


@contextmanager
def asking(operation: Operation) -> Iterator[None]:
    """Report the request in the block."""
    begun, failed = time.perf_counter(), True
    try:
        yield
        failed = False
    finally:
        for watcher in _watchers:
            watcher.asked(operation, time.perf_counter() - begun, failed=failed)


def report_look_up(*, found: bool) -> None:
    for watcher in _watchers:
        watcher.looked_up(found=found)
