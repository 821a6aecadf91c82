"""The client that a robot's own code uses."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, SupportsFloat, Unpack

from .errors import ExpMapError
from .fixes import Fix, FixFields, request_fix
from .motion_filter import MotionFilter
from .options import RobotOptions, RobotStatus
from .records import (
    ObjectFields,
    PoseFields,
    StatusFields,
    end_record,
    object_record,
    parse_record,
    pose_record,
    status_record,
    to_json,
)
from .schema import Identity
from .spool import Spool
from .uplink import Uplink
from .uploader import Backoff, Uploader, UploadStep

_log = logging.getLogger(__name__)
_PATIENCE_S = 5.0


class RobotClient:
    """Sends poses, objects and photos of one mission; unsent data is kept on the robot's disk.

    All calls return as soon as the record is in the spool; two threads sync and upload it. Network errors are
    logged under `webapp.robot`, never raised.

    Args:
        url: Address of the server: `https://maps.example.org`.
        token: API token, from `expmap account token`.
        spool: Folder for the records of this mission only; the next start continues it.
        about: Source of the data; a spool with a different `about` is refused.

    Raises:
        UsageError: The spool is of another mission, or an option is invalid.
        Conflict: Another program uses the spool.
        StorageError, DiskFull: The spool cannot be written.
    """

    def __init__(
        self,
        url: str,
        token: str,
        *,
        mission: int,
        spool: Path | str,
        options: RobotOptions | None = None,
        about: str = "",
    ) -> None:
        self._options = options or RobotOptions()
        self._filters: dict[tuple[str, str], MotionFilter] = {}
        MotionFilter(self._options.min_move)  # raise at once if `min_move` is invalid
        self._server = (url, token)
        uplink = Uplink(url, token, timeout_s=self._options.timeout_s)
        self._spool = Spool(Path(spool), identity=Identity("", mission, url, about), options=self._options)
        self._uplink = uplink
        self._uploader = Uploader(self._spool, uplink, options=self._options)
        self._backoff = Backoff(self._options.backoff_s, self._options.backoff_max_s)
        self._online: bool | None = None
        self._problem = ""
        self._refused: ExpMapError | None = None
        self._writing = threading.Lock()
        self._closing = threading.Event()
        self._dirty = threading.Event()
        self._wake = threading.Event()
        self._idle = threading.Condition()
        self._threads = [threading.Thread(target=self._upload_loop, name="robot upload", daemon=True)]
        if self._options.sync_s > 0:
            self._threads.append(threading.Thread(target=self._sync_loop, name="robot sync", daemon=True))
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(wait_s=_PATIENCE_S if kind is None else 0.0)

    def pose(
        self,
        lat: SupportsFloat,
        lon: SupportsFloat,
        *,
        time_s: SupportsFloat | None = None,
        **more: Unpack[PoseFields],
    ) -> bool:
        """Send the position of the robot.

        Args:
            lat, lon: Degrees north, degrees east, WGS 84.
            time_s: Seconds since 1970, UTC; defaults to now.
            **more: `height_m`, `heading_deg`, `covariance`, `source`, `track`, `travelled_m`, `skipped`.

        Returns:
            False if `min_move` left it out, because the robot hardly moved.

        Raises:
            InputError: A field is invalid or unknown; nothing was written.
            DiskFull, StorageError: Nothing was written.
        """
        record = pose_record(lat, lon, time=time.time() if time_s is None else time_s, **more)
        return self._write(record)

    def object(
        self,
        id: str | None,
        kind: str,
        *,
        lat: SupportsFloat,
        lon: SupportsFloat,
        time_s: SupportsFloat | None = None,
        **more: Unpack[ObjectFields],
    ) -> None:
        """Send an object that the robot sees.

        Args:
            id: Identifies the object across sightings; None: the server associates the sighting.
            kind: Its class: `car`, `victim` ...
            lat, lon: Of the object: degrees north, degrees east, WGS 84.
            time_s: Seconds since 1970, UTC; defaults to now.
            **more: `height_m`, `covariance`, `confidence`, `size_m`, `photo`.

        Raises:
            InputError, DiskFull, StorageError: Nothing was written.
        """
        when = time.time() if time_s is None else time_s
        self._write(object_record(id, kind, lat=lat, lon=lon, time=when, **more))

    def report(self, *, time_s: SupportsFloat | None = None, **more: Unpack[StatusFields]) -> None:
        """Send how the robot is; people see the latest report.

        Args:
            time_s: Seconds since 1970, UTC; defaults to now.
            **more: `battery_percent`, `link_percent`, `mode`, `text`, `track`.

        Raises:
            InputError, DiskFull, StorageError: Nothing was written.
        """
        self._write(status_record(time=time.time() if time_s is None else time_s, **more))

    def photo(
        self,
        file: Path | str | BinaryIO,
        *,
        name: str = "",
        time_s: float | None = None,
        object_id: str | None = None,
    ) -> str:
        """Send a photo, after the records.

        Args:
            file: Copied to the spool.
            name: Name to display; defaults to the file's name.
            time_s: When it was taken: seconds since 1970, UTC; defaults to now.
            object_id: The object that it shows.

        Returns:
            Its SHA-256, for the field `photo` of an object.

        Raises:
            DiskFull, StorageError: The photo was not stored.
        """
        when = time.time() if time_s is None else time_s
        if isinstance(file, (str, Path)):
            with Path(file).open("rb") as source:
                return self._spool.add_photo(
                    source, name=name or Path(file).name, time=when, object_id=object_id
                )
        return self._spool.add_photo(file, name=name or "photo", time=when, object_id=object_id)

    def fix(
        self, file: Path | str | BinaryIO, *, time_s: float | None = None, **more: Unpack[FixFields]
    ) -> Fix:
        """Localize a photo on the server and return the answer; the server stores both with the mission.

        This bypasses the spool, so it needs a network connection.

        Args:
            time_s: When it was taken: seconds since 1970, UTC; defaults to now.
            **more: `near`, `heading_deg`, `fov_deg`, `timeout_s`.

        Raises:
            NotReady: The server does not respond, or is busy.
            ExpMapError: The server refuses the request: the file is not a photo, no map covers the mission
                ...
        """
        when = time.time() if time_s is None else time_s
        return request_fix(self._server, self._spool.identity.mission, file=file, time_s=when, **more)

    def send(self, record: dict[str, Any]) -> bool:
        """Send a record in the format of the API: `{"type": "pose", "lat": 50.0755, "lon": 14.4378}`.

        Returns:
            False if `min_move` left it out, because the robot hardly moved.

        Raises:
            InputError, DiskFull, StorageError: Nothing was written.
        """
        checked = parse_record(record, now_s=time.time())
        if checked["type"] == "end":
            self.end()
            return True
        return self._write(checked)

    def end(self, *, left_out: Sequence[Mapping[str, Any]] = ()) -> None:
        """Send the record that ends the mission, and start to upload.

        Args:
            left_out: The last poses that the caller left out, in the format of `end_record`; those that
                `min_move` left out are added.
        """
        with self._writing:
            rests = [{"source": s, "track": t, **asdict(m.flush())} for (s, t), m in self._filters.items()]
        self._write(end_record([*left_out, *(rest for rest in rests if rest["skipped"])]))
        self._wake.set()

    def upload(self, *, wait_s: float = 0.0) -> bool:
        """Start to upload now.

        Args:
            wait_s: Maximum time to wait, seconds.

        Returns:
            Whether everything has been uploaded.
        """
        self._wake.set()
        with self._idle:
            return self._idle.wait_for(self._is_done, timeout=wait_s)

    def recent_records(self) -> Iterator[dict[str, Any]]:
        """Yield the last 20 000 records, newest first; acknowledged ones may have been deleted."""
        return map(json.loads, self._spool.recent())

    def status(self) -> RobotStatus:
        """Return the number of waiting records and the current problem, if any."""
        spool, photos = self._spool, self._spool.photos.count
        return RobotStatus(spool.next, spool.waiting, photos, self._online, self._problem, self._refused)

    def close(self, *, wait_s: float = _PATIENCE_S) -> bool:
        """Upload, and stop; unsent data stays in the spool.

        Args:
            wait_s: Maximum time to wait for the upload, seconds; a request in progress can extend it by
                `timeout_s`.

        Returns:
            Whether everything has been uploaded.
        """
        if self._closing.is_set():
            return self._is_done()
        done = self.upload(wait_s=wait_s)
        self._closing.set()
        self._wake.set()
        self._dirty.set()
        for thread in self._threads:
            thread.join()
        self._uplink.close()
        self._spool.close()
        return done

    def _write(self, record: dict[str, Any]) -> bool:
        with self._writing:
            if record["type"] == "pose" and self._options.min_move != "0" and not self._filter(record):
                return False
            self._spool.append(to_json(record), sync=self._options.sync_s == 0)
        self._dirty.set()
        return True

    def _filter(self, record: dict[str, Any]) -> bool:
        """Apply `min_move` to a pose; return whether it is kept."""
        key = (record.get("source", "gps"), record.get("track", ""))
        if key not in self._filters:
            self._filters[key] = MotionFilter(
                self._options.min_move, travelled_m=self._spool.travelled_m(key)
            )
        kept = self._filters[key].update(record["lat"], record["lon"])
        if kept is None:
            return False
        record.setdefault("travelled_m", round(kept.travelled_m, 3))
        if kept.skipped:
            record["skipped"] = record.get("skipped", 0) + kept.skipped
        return True

    def _is_done(self) -> bool:
        return self._spool.waiting == 0 and self._spool.photos.size == 0

    def _sync_loop(self) -> None:
        while not self._closing.is_set():
            self._dirty.wait()
            self._closing.wait(self._options.sync_s)
            self._dirty.clear()
            self._with_backoff(self._spool.sync)

    def _upload_loop(self) -> None:
        while not self._closing.is_set():
            self._wake.wait(self._options.every_s)
            self._wake.clear()
            while not self._closing.is_set() and self._with_backoff(self._send_some):
                pass

    def _with_backoff(self, work: Callable[[], bool | None]) -> bool | None:
        """Run `work`; on an error report it and wait, so that the thread survives a full disk."""
        try:
            return work()
        except ExpMapError as error:
            self._report(str(error))
            self._closing.wait(self._backoff.next_delay())
            return False

    def _send_some(self) -> bool:
        """Send the records present now, then one photo; return whether to continue at once."""
        until = self._spool.next
        while self._spool.state.next < until and not self._closing.is_set():
            self._handle(self._uploader.send_records())
        if self._closing.is_set():
            return False
        has_more = self._handle(self._uploader.send_photo())
        with self._idle:
            self._idle.notify_all()
        return has_more

    def _handle(self, step: UploadStep) -> bool:
        """Update the status, and back off after a failure; return whether there may be more to send."""
        if step.outcome == "idle":
            return False
        done = step.outcome == "progress"
        self._report("" if done else step.reason)  # before `_online` shows that the server is unreachable
        self._online, self._refused = step.outcome != "retry", step.error
        if done:
            self._backoff.reset()
            return True
        if step.wait_s:
            self._closing.wait(self._backoff.next_delay(at_least_s=step.wait_s))
        elif self._wake.wait(self._backoff.next_delay()):
            self._wake.clear()  # upload() or end() asked to retry now
        return True

    def _report(self, problem: str) -> None:
        if problem and problem != self._problem:
            _log.warning("%s: %s", self._spool.folder, problem)
        self._problem = problem
