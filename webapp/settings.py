"""Every number that can be chosen, with its unit, its default and its purpose.

`webapp.configuration` reads them from the environment and from a file. `docs/settings.md` lists all of them;
a test compares the two.
"""

from __future__ import annotations

import ctypes
import os
import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated


@dataclass(frozen=True, slots=True)
class AtLeast:
    """The least value of a number; without it a number has to be more than 0."""

    value: float


@dataclass(frozen=True, slots=True)
class PhotoLimits:
    """What a photo may cost before it is refused."""

    max_mb: float = 64.0
    """Size of the file, megabytes (10^6 bytes)."""

    max_megapixels: float = 120.0
    """Pixels of the decoded photo, millions; a third of it for WebP and JPEG 2000."""


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """How files come in through the web."""

    chunk_mb: float = 4.0
    """Largest chunk of a resumable upload, megabytes (10^6 bytes)."""

    files_per_request: int = 200
    """Photos in one request."""

    open_per_account: int = 200
    """Uploads that an account may have begun and not finished."""

    keep_hours: float = 48.0
    """How long an unfinished upload waits to be resumed."""

    reserve_mb: Annotated[float, AtLeast(0)] = 200.0
    """Disk space that uploads and unpacked maps leave free, megabytes (10^6 bytes)."""

    queries_per_map: int = 500
    """Queries of a map that are kept, with their photos and answers; the oldest are deleted first."""


@dataclass(frozen=True, slots=True)
class ImportLimits:
    """What a zip with a map may hold."""

    max_mb: float = 20_000.0
    """Its files together, unpacked, megabytes (10^6 bytes)."""

    max_files: int = 50_000
    """Files and folders; lines of its `.cfg` files."""

    max_ratio: float = 200.0
    """Bytes of a file for each byte that it has in the zip; photos have about one."""


@dataclass(frozen=True, slots=True)
class ExtractSettings:
    """What is computed from each photo. Part of the key of an index."""

    max_side_px: Annotated[int, AtLeast(64)] = 800
    """Photos are scaled down until the longer side has this many pixels."""

    keypoints: Annotated[int, AtLeast(16)] = 1000
    """Maximum number of keypoints a photo; the strongest are kept."""


@dataclass(frozen=True, slots=True)
class RetrievalSettings:
    """How a map is searched."""

    memory_mb: Annotated[float, AtLeast(0)] = 500.0
    """What the index of a map may take, megabytes (10^6 bytes): beyond, photos have one signature each."""

    shortlist: int = 12
    """Photos of the map that geometry verifies for each query: those with the most votes."""

    budget_s: Annotated[float, AtLeast(0)] = 5.0
    """Method `auto` looks a second time where that takes at most so many seconds a photo here; 0: never."""


@dataclass(frozen=True, slots=True)
class LandmarkSettings:
    """Landmarks around the place of a query, where the map has none."""

    around_s: Annotated[float, AtLeast(0)] = 120.0
    """Seconds that method `landmarks` may take to reconstruct the surroundings of a place; 0: never."""

    around_photos: Annotated[int, AtLeast(8)] = 40
    """Photos that are reconstructed, those nearest to the best one; a panorama counts as six."""


@dataclass(frozen=True, slots=True)
class WebSettings:
    """What the pages and the API allow."""

    max_request_mb: float = 2000.0
    """Largest request, megabytes (10^6 bytes); a satellite image comes in one."""

    requests_per_minute: int = 6000
    """To the API, of one account or address, in each worker process; in all together, with PostgreSQL."""

    session_days: int = 14
    """Days without a visit after which a user must sign in again."""

    link_hours: int = 24
    """How long a sign-in link works."""

    min_password: int = 10
    """Characters of a password, at least."""

    sign_in_failures: int = 10
    """Failures of one name or from one address after which the next sign-in has to wait."""

    sign_in_minutes: int = 15
    """Minutes within which those failures count."""

    visitor_questions_per_minute: int = 10
    """Photos a visitor of a shared map may ask about, per worker process, or in total with PostgreSQL."""

    share_questions_per_minute: int = 60
    """... and all visitors of a shared map together, counted in the same way."""

    proxies: Annotated[int, AtLeast(0)] = 0
    """Reverse proxies in front of the server: their headers about the client are trusted."""


@dataclass(frozen=True, slots=True)
class ServeSettings:
    """The processes that answer requests."""

    workers: int = 3
    """Processes; the option `--workers` overrides it."""

    threads: int = 8
    """Requests at once in each of them."""

    patience_s: float = 15.0
    """Seconds that a request may keep a thread waiting, and one more for each 2000 bytes that arrive."""

    stop_s: float = 5.0
    """Seconds that active requests have to end when the server stops."""

    drain_s: Annotated[float, AtLeast(0)] = 0.0
    """Seconds for which a server that has to stop says that it is not ready, and still answers."""

    job_workers: Annotated[int, AtLeast(0)] = 1
    """Background workers that the server starts; with 0, others on the same library do its jobs."""

    metrics_token: str | None = None
    """Whoever sends it gets the figures of `/metrics`; without one there are none."""


@dataclass(frozen=True, slots=True)
class JobSettings:
    """Long work in the background."""

    lease_s: float = 12.0
    """Seconds without a renewal of its lease after which another worker takes a job over."""

    attempts: int = 5
    """Number of workers that may die on a job in a row, without a step done, before it fails."""

    stop_s: float = 4.0
    """Seconds that a job has to finish a step when its worker has to stop."""

    export_s: float = 0.5
    """Seconds between two exports of maps whose files are older than their records."""


@dataclass(frozen=True, slots=True)
class SatelliteLimits:
    """What a satellite image may cost before it is refused."""

    max_mb: float = 1000.0
    """Size of an uploaded file, megabytes (10^6 bytes)."""

    max_megapixels: float = 300.0
    """Pixels, millions."""


@dataclass(frozen=True, slots=True)
class TileSettings:
    """How map tiles are fetched from a service, and how many."""

    max_tiles: int = 1600
    """For one satellite image; a service can have a lower limit of its own."""

    parallel: int = 4
    """Requests at the same time."""

    requests_per_second: float = 10.0
    """To one host."""

    timeout_s: float = 20.0
    """Seconds without an answer after which a request is tried again."""

    cache_days: float = 30.0
    """Days that tiles stay in the cache."""


@dataclass(frozen=True, slots=True)
class GeocoderSettings:
    """How places are searched by their names: by asking another host, or not at all."""

    address: str | None = None
    """Of a search that speaks Nominatim's API; none: places are not searched."""

    attribution: str = "© OpenStreetMap contributors"
    """Who is named below what was found."""

    requests_per_second: float = 1.0
    """To this host, from all processes together."""

    timeout_s: float = 10.0
    """Seconds without an answer after which a search fails."""

    cache_days: float = 30.0
    """Days that results stay in the cache."""


@dataclass(frozen=True, slots=True)
class StreetSettings:
    """Services that street-level photos are fetched from; without an address or a token, none."""

    panoramax: str | None = None
    """Address of a Panoramax instance, whose STAC API is asked; none: not used."""

    mapillary_token: str | None = None
    """Access token for Mapillary; none: not used."""

    mapillary: str = "https://graph.mapillary.com"
    """Address of Mapillary's API."""

    photo_hosts: str = (
        "panoramax.xyz, panoramax.fr, panoramax.ign.fr, panoramax.openstreetmap.fr, "
        "panoramax-storage-public-fast.s3.gra.perf.cloud.ovh.net, fbcdn.net"
    )
    """Hosts that photos may come from, and all below them, besides that of the service itself."""

    max_photos: int = 2000
    """Of one area."""

    parallel: int = 2
    """Photos fetched at the same time."""

    requests_per_second: float = 4.0
    """To a service and the hosts of its photos together."""

    timeout_s: float = 30.0
    """Seconds without an answer after which a request is tried again."""

    patience_s: float = 120.0
    """Seconds that a service may ask to wait; when it wants more, the work stops and is continued later."""


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """What robots send."""

    batch_records: int = 5000
    """Records of one batch."""

    batch_mb: float = 2.0
    """Size of one batch, megabytes (10^6 bytes)."""

    keep_keys_days: float = 30.0
    """Days that a batch repeated with the same key is recognised."""

    stream_s: float = 25.0
    """Seconds after which a stream of events ends; browsers open the next one by themselves."""

    look_s: float = 0.3
    """Seconds between two looks for the next event of a stream."""

    thin_after_days: Annotated[float, AtLeast(0)] = 0.0
    """Days without a change after which the tracks of a mission are thinned; 0: never."""

    thin_to_m: float = 1.0
    """Largest error of a thinned track, metres."""

    prune_after_days: Annotated[float, AtLeast(0)] = 0.0
    """Days without a change after which only both ends of its tracks are left; 0: never."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of one run."""

    photo: PhotoLimits = field(default_factory=PhotoLimits)
    upload: UploadLimits = field(default_factory=UploadLimits)
    imports: ImportLimits = field(default_factory=ImportLimits)
    extract: ExtractSettings = field(default_factory=ExtractSettings)
    retrieval: RetrievalSettings = field(default_factory=RetrievalSettings)
    landmarks: LandmarkSettings = field(default_factory=LandmarkSettings)
    web: WebSettings = field(default_factory=WebSettings)
    serve: ServeSettings = field(default_factory=ServeSettings)
    jobs: JobSettings = field(default_factory=JobSettings)
    satellite: SatelliteLimits = field(default_factory=SatelliteLimits)
    tiles: TileSettings = field(default_factory=TileSettings)
    geocoder: GeocoderSettings = field(default_factory=GeocoderSettings)
    street: StreetSettings = field(default_factory=StreetSettings)
    missions: MissionSettings = field(default_factory=MissionSettings)
    library: Path = Path("maps")
    """Folder of the maps."""

    database: str | None = None
    """Address of a PostgreSQL database for the records, instead of a SQLite file in the library's folder."""
    storage: str | None = None
    """Where photos and indexes are kept, `s3://bucket/prefix`, instead of in the library's folder."""
    orphans_h: Annotated[float, AtLeast(1)] = 24.0
    """Hours after which objects that nothing names are deleted."""
    cache_gb: Annotated[float, AtLeast(0.1)] = 20.0
    """GB of objects kept on the disk of this machine."""

    cache_folder: Path | None = None
    """Folder for them, instead of one in the user's cache."""

    dask: str | None = None
    """Address of a scheduler of Dask, `tcp://HOST:8786`, whose workers compute, instead of this machine."""

    traces: str | None = None
    """Address of a collector of OpenTelemetry, `http://HOST:4318`, that spans are sent to."""

    models: Path | None = None
    """Folder with the weights of learned features, instead of one in the user's cache."""

    token: str | None = None
    """Of the server that `expmap robot` sends to."""

    tile_services: Path | None = None
    """File with the map tile services to offer, instead of the usual ones."""


def let_threads_sleep() -> None:
    """Make OpenMP's threads sleep while they wait for each other; it reads this when it is loaded.

    By default they wait in a busy loop: where other programs want the cores too, a search took thirty times
    as long. Who set `OMP_WAIT_POLICY` is not overruled.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # parameters of mallopt(3)
_LARGEST_KEPT, _MOST_KEPT = 32 << 20, 512 << 20  # bytes of one block, and of all


def keep_freed_memory() -> None:
    """Make glibc keep what OpenCV and NumPy free, for a process that takes one photo after the other.

    Allocating the memory of a photo's scales each time took a sixth of the time of a build, and of a query.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT)
        libc.mallopt(_M_TRIM_THRESHOLD, _MOST_KEPT)


_HEAPS = {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": "1000000", "MALLOC_TRIM_THRESHOLD_": "4000000"}
"""For the C library of Linux. By default each thread that localizes keeps a heap of its own of 64 MB, full of
arrays that are long gone: more than twice the memory of all processes, and not a second saved."""


def environment_for(native_threads: int | None = None) -> dict[str, str]:
    """Make the environment of a server process: few native threads, and heaps that shrink again.

    What reads these variables does so when it is loaded. What the user has set is not overruled.

    Parameters
    ----------
    native_threads : int, optional
        That OpenMP and OpenBLAS may start; by default as many as they like.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if native_threads else ()
    return {name: str(native_threads) for name in names} | _HEAPS | dict(os.environ)


METRICS_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
"""Variable of the Prometheus client: the folder by which the processes of a server share what they count."""


def shares_metrics() -> bool:
    """Return whether this process shares what it counts with others."""
    return bool(os.environ.get(METRICS_FOLDER))
