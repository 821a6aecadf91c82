"""A bucket of an S3 server, by boto3, whose errors it raises as those of the program."""

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
from typing import Any
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
from webapp.files.object_storage.watch import Operation, asking

_log = logging.getLogger(__name__)

_PIECE = 8 << 20
"""Bytes of a piece: larger files come and go in several at once."""

_AT_ONCE = 8

_BLOCK = 1 << 20

TIMEOUT_S = 10.0
"""Seconds for which the server may be silent; after a second try it counts as away."""

PROBE_TIMEOUT_S = 2.0
"""The same for whoever only wants to know whether it is there, and does not try again."""

_WAIT_S = 5

_LOG_EVERY_S = 60.0

_REFUSED = frozenset({"AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "ExpiredToken", "403"})
_FULL = frozenset({"QuotaExceeded", "InsufficientStorage", "XMinioStorageFull", "InsufficientCapacity"})
_NO_OBJECT = frozenset({"NoSuchKey", "404"})
_NO_BUCKET = "NoSuchBucket"
_DAMAGED = "BadDigest"


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object in a list.

    Attributes
    ----------
    key : str
        Below the prefix.
    """

    key: str
    bytes: int
    changed_at: datetime


class Bucket:
    """The objects below a prefix of a bucket.

    Parameters
    ----------
    url : str
        `s3://bucket/prefix`; server and credentials are those of boto3: `AWS_ENDPOINT_URL`,
        `AWS_ACCESS_KEY_ID` and so on.
    timeout_s : float
        For which a connection may be silent.

    Raises
    ------
    UsageError
        The address is malformed, or boto3 cannot use the configuration that it finds.
    MissingPart
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
        """Store a file; when this returns, the server has all of it, and has compared it with its MD5.

        Raises
        ------
        StorageUnavailable, DiskFull, StorageError
            Nothing of it can be read.
        """
        with self._asking("put", key), file.open("rb") as source:
            self._client.upload_fileobj(source, self._bucket, self._prefix + key, Config=self._transfer)

    def get(self, key: str, target: Path) -> None:
        """Write an object to a new file, of which something may be left after an error.

        Raises
        ------
        ObjectLost, StorageUnavailable, DiskFull, StorageError
        """
        with self._asking("get", key):
            self._client.download_file(self._bucket, self._prefix + key, str(target), Config=self._transfer)

    def probe(self) -> None:
        """Ask for nearly nothing, to see whether the server answers.

        Raises
        ------
        StorageUnavailable, StorageError
            It does not within `PROBE_TIMEOUT_S`, or refuses.
        """
        with self._asking("probe", self.url):
            self._probe.list_objects_v2(Bucket=self._bucket, Prefix=self._prefix, MaxKeys=1)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with self._asking("delete", key):
            self._client.delete_object(Bucket=self._bucket, Key=self._prefix + key)

    def objects(self) -> Iterator[StoredObject]:
        """List all objects below the prefix.

        Raises
        ------
        StorageUnavailable, StorageError
        """
        for page in self._pages("list_objects_v2"):
            for one in page.get("Contents", ()):
                key = one["Key"].removeprefix(self._prefix)
                yield StoredObject(key, one["Size"], one["LastModified"])

    def drop_unfinished(self, *, begun_before: datetime) -> int:
        """Delete the pieces of uploads that were interrupted; returns of how many.

        Raises
        ------
        StorageUnavailable, StorageError
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
        """Yield the pages of a list below the prefix."""
        pages = iter(self._client.get_paginator(operation).paginate(Bucket=self._bucket, Prefix=self._prefix))
        is_more = True
        while is_more:
            with self._asking("list", self.url):
                page: dict[str, Any] = next(pages, {})
            yield page
            is_more = page.get("IsTruncated", False)

    @contextmanager
    def _asking(self, operation: Operation, key: str) -> Iterator[None]:
        """Count a request, and raise its errors as those of the program, which are in the log, too."""
        try:
            with asking(operation), self._translated(key):
                yield
        except ObjectLost:
            raise  # whether that is an error, the caller knows
        except StorageError as error:
            self._log_seldom(error.message)
            raise

    def _log_seldom(self, message: str) -> None:
        """Log a sentence, but not for each of the requests that meet the same."""
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
    """Make a client of boto3, which threads may share, and how it moves files."""
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
        request_checksum_calculation="when_required",  # which other servers than Amazon's do not all know
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
    """Send the MD5 of a file or piece with it, so that the server refuses what was damaged on the way."""
    body, digest = params["Body"], hashlib.md5(usedforsecurity=False)
    start = body.tell()
    while block := body.read(_BLOCK):
        digest.update(block)
    body.seek(start)
    params["ContentMD5"] = base64.b64encode(digest.digest()).decode("ascii")


def _away(error: Exception) -> StorageUnavailable:
    """Say in our words how the connection failed; of several tries, the last."""
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
    """Say in our words why the server refuses."""
    code = str(response.get("Error", {}).get("Code", ""))
    status = response.get("ResponseMetadata", {}).get("HTTPStatusCode", 0)
    if code == _NO_BUCKET:
        return StorageUnavailable(
            "the bucket of the object storage does not exist",
            wait_s=_WAIT_S,
            where=url,
            hint="ask who looks after the server",
        )
    if code in _NO_OBJECT:
        return ObjectLost("the object storage has lost this file", where=key, hint="restore it from a backup")
    if code == _DAMAGED:
        return StorageUnavailable(
            "the file was damaged on its way to the object storage",
            wait_s=_WAIT_S,
            where=key,
            hint="try again in a moment",
        )
    if code in _FULL or status == HTTPStatus.INSUFFICIENT_STORAGE:
        return DiskFull("the object storage is full", where=url, hint="ask who looks after the server")
    if code in _REFUSED or status == HTTPStatus.FORBIDDEN:
        return StorageUnavailable(
            "the object storage refuses access", wait_s=_WAIT_S, hint="ask who looks after the server"
        )
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status == HTTPStatus.TOO_MANY_REQUESTS:
        return StorageUnavailable(
            "the object storage is overloaded or out of order", wait_s=_WAIT_S, hint="try again in a moment"
        )
    return StorageError(f"the object storage refused the request: {code or status}", where=url)
