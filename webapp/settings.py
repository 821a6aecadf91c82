"""All settings, with their units, defaults and purposes.

`webapp.configuration` reads them from the environment and from a file. `docs/settings.md` lists all of them;
a test keeps the two in step.
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
    """Minimum of a numeric setting; without it the number has to be more than 0."""

    value: float


@dataclass(frozen=True, slots=True)
class OneOf:
    """The values that a text setting can have."""

    values: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PhotoLimits:
    """Limits of a photo; larger ones are rejected."""

    max_mb: float = 64.0
    """File size, MB."""

    max_megapixels: float = 120.0
    """Pixels of the decoded photo, millions; for WebP and JPEG 2000 a third of this."""


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """Limits of uploads through the web."""

    chunk_mb: float = 4.0
    """Largest chunk of a resumable upload, MB."""

    files_per_request: int = 200
    """Photos in one request."""

    video_mb: float = 4000.0
    """Largest video that is cut into photos, megabytes (10^6 bytes)."""

    open_per_account: int = 200
    """Unfinished uploads per account."""

    keep_hours: float = 48.0
    """Hours for which an unfinished upload can be resumed."""

    reserve_mb: Annotated[float, AtLeast(0)] = 200.0
    """Disk space that uploads and unpacked maps must leave free, MB."""

    queries_per_map: int = 500
    """Stored queries per map, with their photos and answers; the oldest are deleted first."""


@dataclass(frozen=True, slots=True)
class FileLimits:
    """What reading a file with tracks may cost; it is read in a process of its own."""

    memory_mb: Annotated[float, AtLeast(50)] = 500.0
    """Memory, MB, in addition to some 50 MB of the process itself."""

    cpu_s: float = 20.0
    """CPU time, seconds."""

    cpu_s_per_mb: Annotated[float, AtLeast(0)] = 10.0
    """Further CPU time for each MB of the file, seconds."""

    request_s: float = 10.0
    """Seconds that a request may take to read a small file; after that, a job reads it."""

    at_once: Annotated[int, AtLeast(1)] = 2
    """Files that requests read at the same time, at most one per account; for others the server is busy."""


@dataclass(frozen=True, slots=True)
class ImportLimits:
    """Limits of a zip archive with a map."""

    max_mb: float = 20_000.0
    """Total size of the unpacked files, MB."""

    max_files: int = 50_000
    """Number of files and folders, and of lines in its `.cfg` files."""

    max_ratio: float = 200.0
    """Maximum compression ratio of a file, and of all together; that of photos is about one."""


@dataclass(frozen=True, slots=True)
class ExtractSettings:
    """Feature extraction; part of the key of an index."""

    max_side_px: Annotated[int, AtLeast(64)] = 800
    """Photos are scaled down so that the longer side has this many pixels."""

    keypoints: Annotated[int, AtLeast(16)] = 1000
    """Maximum number of keypoints per photo; the strongest are kept."""


@dataclass(frozen=True, slots=True)
class RetrievalSettings:
    """How a map is searched."""

    memory_mb: Annotated[float, AtLeast(0)] = 500.0
    """Memory limit of a map's index, MB; above it, photos have one signature each."""

    shortlist: int = 12
    """Map photos per query whose geometry is verified: those with the most votes."""

    budget_s: Annotated[float, AtLeast(0)] = 5.0
    """Method `auto` takes a second look if it needs at most this many seconds per photo here; 0: never."""


@dataclass(frozen=True, slots=True)
class LandmarkSettings:
    """Landmarks reconstructed around the place of a query where the map has none."""

    around_s: Annotated[float, AtLeast(0)] = 120.0
    """Seconds that method `landmarks` may take to reconstruct the surroundings of a place; 0: never."""

    around_photos: Annotated[int, AtLeast(8)] = 40
    """Number of photos in such a reconstruction, those nearest to the best one; a panorama counts as six."""


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Limits of the pages and the API."""

    max_request_mb: float = 2000.0
    """Largest request, MB; a satellite image is uploaded in one request."""

    requests_per_minute: int = 6000
    """API requests per account or IP address, per worker process, or in total with PostgreSQL."""

    session_days: int = 14
    """Days without a visit after which a session expires."""

    link_hours: int = 24
    """Hours for which a sign-in link is valid."""

    min_password: int = 10
    """Minimum length of a password, characters."""

    sign_in_failures: int = 10
    """Failed sign-ins for one name or from one IP address after which the next one has to wait."""

    sign_in_minutes: int = 15
    """Minutes within which those failures count."""

    visitor_questions_per_minute: int = 10
    """Queries per visitor of a shared map, per worker process, or in total with PostgreSQL."""

    share_questions_per_minute: int = 60
    """Queries of all visitors of a shared map together, counted in the same way."""

    proxies: Annotated[int, AtLeast(0)] = 0
    """Number of reverse proxies in front of the server, whose `X-Forwarded-*` headers are trusted."""


@dataclass(frozen=True, slots=True)
class ContributionSettings:
    """Limits of photos that visitors of shared maps give."""

    max_mb: float = 30.0
    """Largest photo, megabytes."""

    photos_per_day: int = 30
    """Photos of a visitor of a share on one day."""

    mb_per_day: float = 300.0
    """The same, megabytes."""

    waiting_photos: int = 300
    """Photos of a map that may wait for a decision."""

    waiting_mb: float = 3000.0
    """The same, megabytes."""


@dataclass(frozen=True, slots=True)
class ServeSettings:
    """The processes that answer requests."""

    workers: int = 3
    """Number of processes; the option `--workers` overrides it."""

    threads: int = 8
    """Concurrent requests per process; as many more that localize."""

    patience_s: float = 15.0
    """Seconds that a thread waits for a request to arrive, plus one for each 2000 bytes received."""

    stop_s: float = 5.0
    """Seconds that active requests have to finish when the server stops."""

    drain_s: Annotated[float, AtLeast(0)] = 0.0
    """Seconds for which a stopping server still answers, but reports that it is not ready."""

    job_workers: Annotated[int, AtLeast(0)] = 1
    """Background workers that the server starts; with 0, separate workers have to run its jobs."""

    metrics_token: str | None = None
    """Token that `/metrics` requires; none: there is no `/metrics`."""


@dataclass(frozen=True, slots=True)
class JobSettings:
    """Background jobs."""

    lease_s: float = 12.0
    """Seconds without a renewal of its lease after which another worker takes a job over."""

    attempts: int = 5
    """Number of workers in a row that may die on a job, without finishing a step, before it fails."""

    stop_s: float = 4.0
    """Seconds that a job has to finish a step when its worker has to stop."""

    export_s: float = 0.5
    """Seconds between two exports of maps whose files are older than their records."""

    short_workers: Annotated[int, AtLeast(0)] = 1
    """Further processes for short jobs only, beside the workers of `serve` and beside each `worker`."""


@dataclass(frozen=True, slots=True)
class SatelliteLimits:
    """Limits of a satellite image; larger ones are rejected."""

    max_mb: float = 1000.0
    """Size of an uploaded file, MB."""

    max_megapixels: float = 300.0
    """Pixels, millions."""


@dataclass(frozen=True, slots=True)
class TileSettings:
    """Fetching of map tiles from a service."""

    max_tiles: int = 1600
    """Tiles per satellite image; a service can have a lower limit of its own."""

    requests_per_second: float = 10.0
    """Rate limit per host."""

    timeout_s: float = 20.0
    """Seconds without a response after which a request is repeated."""

    cache_days: float = 30.0
    """Days that tiles stay in the cache."""


@dataclass(frozen=True, slots=True)
class RemoteSettings:
    """Remote files of map tiles (PMTiles, cloud-optimised GeoTIFF), of which only parts are fetched."""

    enabled: Annotated[str, OneOf(("no", "yes"))] = "no"
    """`yes`: tile services may be such files."""

    private_hosts: str | None = None
    """Hosts and networks that are accepted although they are not public, separated by commas."""

    timeout_s: float = 20.0
    """Longest wait for a part of an answer, seconds."""

    check_s: float = 3600.0
    """Seconds after which the server is asked whether the file has changed."""

    most_mb: float = 32.0
    """Megabytes that may be fetched for one tile."""

    cache_mb: float = 1000.0
    """Megabytes that the parts of all files may take on disk."""


@dataclass(frozen=True, slots=True)
class GeocoderSettings:
    """Search for places by name, with an external geocoder."""

    address: str | None = None
    """Address of a geocoder with Nominatim's API; none: no search for places."""

    attribution: str = "© OpenStreetMap contributors"
    """Attribution shown below the results."""

    requests_per_second: float = 1.0
    """Rate limit of this host, for all processes together."""

    timeout_s: float = 10.0
    """Seconds without a response after which a search fails."""

    cache_days: float = 30.0
    """Days that results stay in the cache."""


@dataclass(frozen=True, slots=True)
class StreetSettings:
    """Services that street-level photos are fetched from; without an address or a token, none."""

    panoramax: str | None = None
    """Address of a Panoramax instance, whose STAC API is used; none: not used."""

    mapillary_token: str | None = None
    """Access token for Mapillary; none: not used."""

    mapillary: str = "https://graph.mapillary.com"
    """Address of Mapillary's API."""

    photo_hosts: str = (
        "panoramax.xyz, panoramax.fr, panoramax.ign.fr, panoramax.openstreetmap.fr, "
        "panoramax-storage-public-fast.s3.gra.perf.cloud.ovh.net, fbcdn.net"
    )
    """Hosts, including their subdomains, that photos may come from, in addition to the service's own."""

    max_photos: int = 2000
    """Photos per area."""

    parallel: int = 2
    """Concurrent downloads of photos."""

    requests_per_second: float = 4.0
    """Rate limit of a service and the hosts of its photos together."""

    timeout_s: float = 30.0
    """Seconds without a response after which a request is repeated."""

    patience_s: float = 120.0
    """Longest wait that a service may demand, seconds; beyond it the work stops and is continued later."""


@dataclass(frozen=True, slots=True)
class MissionSettings:
    """Missions: uploads from robots, event streams, and thinning of old tracks."""

    batch_records: int = 5000
    """Maximum number of records in a batch, which may have 400 bytes each on average."""

    stream_s: float = 25.0
    """Seconds after which an event stream is closed; browsers reconnect automatically."""

    look_s: float = 0.3
    """Polling interval for the next event of a stream, seconds."""

    thin_after_days: Annotated[float, AtLeast(0)] = 0.0
    """Days without a change after which the tracks of a mission are thinned; 0: never."""

    thin_to_m: float = 1.0
    """Largest error of a thinned track, metres."""

    prune_after_days: Annotated[float, AtLeast(0)] = 0.0
    """Days without a change after which only the first and last poses of its tracks are kept; 0: never."""


@dataclass(frozen=True, slots=True)
class EventSettings:
    """Messages on events, by webhooks and e-mail."""

    site: str | None = None
    """Address of this server, such as `https://maps.example.org`, for links in messages; none: no links."""

    private_hosts: str | None = None
    """Hosts and networks that webhooks may go to although they are private, separated by commas."""

    timeout_s: float = 10.0
    """Seconds without a response after which a try fails; a whole try takes at most four times as long."""

    give_up_h: float = 24.0
    """Hours after which an event that cannot be delivered is given up."""


@dataclass(frozen=True, slots=True)
class MailSettings:
    """The server that e-mail is sent by."""

    host: str | None = None
    """Name of an SMTP server; none: no e-mail."""

    port: Annotated[int, AtLeast(0)] = 0
    """Its port; 0: the usual one, 587 with STARTTLS, 465 with TLS, 25 without."""

    security: str = "starttls"
    """`starttls`, `tls`, or `none` for a server on this machine."""

    user: str | None = None
    """Name to sign in with; none: no sign-in."""

    password: str | None = None
    """Its password."""

    sender: str | None = None
    """Address that messages come from."""


@dataclass(frozen=True, slots=True)
class LibrarySettings:
    """Photo libraries that accounts connect: Immich and PhotoPrism."""

    private_hosts: str | None = None
    """Hosts and networks that a library may have although they are private, separated by commas."""

    max_photos: int = 10_000
    """Photos of an album."""

    requests_per_second: float = 8.0
    """Rate limit of a library."""

    timeout_s: float = 20.0
    """Seconds without a response after which a request is repeated."""

    patience_s: float = 120.0
    """Longest pause that a library may ask for, in seconds; for a longer one, the job fails."""


@dataclass(frozen=True, slots=True)
class OidcSettings:
    """Sign-in by an OpenID Connect provider."""

    issuer: str | None = None
    """Address of the provider, as in its documents; none: no sign-in there."""

    client_id: str | None = None
    """Name of this server at the provider."""

    client_secret: str | None = None
    """Secret of this server at the provider; none: a public client."""

    name: str | None = None
    """Name of the provider on the pages; none: its host."""

    scopes: str = "openid profile email"
    """What is asked for, separated by spaces."""

    groups_claim: str = "groups"
    """Claim with the groups of a person."""

    accounts: Annotated[str, OneOf(("linked", "groups", "everybody"))] = "linked"
    """Who gets in: `linked` identities, those in listed `groups`, or `everybody` at the provider."""

    match_email: Annotated[str, OneOf(("no", "verified"))] = "no"
    """`verified`: a new identity gets the account with the same confirmed e-mail address."""

    required: Annotated[str, OneOf(("no", "yes"))] = "no"
    """`yes`: no sign-in by passwords, and by links from the command line only."""

    timeout_s: float = 10.0
    """Seconds without an answer after which a request to the provider fails."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of one run."""

    photo: PhotoLimits = field(default_factory=PhotoLimits)
    upload: UploadLimits = field(default_factory=UploadLimits)
    files: FileLimits = field(default_factory=FileLimits)
    imports: ImportLimits = field(default_factory=ImportLimits)
    extract: ExtractSettings = field(default_factory=ExtractSettings)
    retrieval: RetrievalSettings = field(default_factory=RetrievalSettings)
    landmarks: LandmarkSettings = field(default_factory=LandmarkSettings)
    web: WebSettings = field(default_factory=WebSettings)
    serve: ServeSettings = field(default_factory=ServeSettings)
    jobs: JobSettings = field(default_factory=JobSettings)
    satellite: SatelliteLimits = field(default_factory=SatelliteLimits)
    tiles: TileSettings = field(default_factory=TileSettings)
    contributions: ContributionSettings = field(default_factory=ContributionSettings)
    remote: RemoteSettings = field(default_factory=RemoteSettings)
    geocoder: GeocoderSettings = field(default_factory=GeocoderSettings)
    street: StreetSettings = field(default_factory=StreetSettings)
    missions: MissionSettings = field(default_factory=MissionSettings)
    events: EventSettings = field(default_factory=EventSettings)
    mail: MailSettings = field(default_factory=MailSettings)
    libraries: LibrarySettings = field(default_factory=LibrarySettings)
    oidc: OidcSettings = field(default_factory=OidcSettings)
    library: Path = Path("maps")
    """Folder of the maps."""

    database: str | None = None
    """Address of a PostgreSQL database for the records, instead of a SQLite file in the library's folder."""
    storage: str | None = None
    """Object storage for photos and indexes, `s3://bucket/prefix`, instead of the library's folder."""
    orphans_h: Annotated[float, AtLeast(1)] = 24.0
    """Hours after which unreferenced objects are deleted."""
    cache_gb: Annotated[float, AtLeast(0.1)] = 20.0
    """Size of the local cache of objects, GB."""

    cache_folder: Path | None = None
    """Folder of that cache, instead of one in the user's cache."""

    dask: str | None = None
    """Address of a Dask scheduler, `tcp://HOST:8786`, whose workers compute instead of this machine."""

    traces: str | None = None
    """Address of an OpenTelemetry collector, `http://HOST:4318`, that spans are sent to."""

    models: Path | None = None
    """Folder with the weights of learned features, instead of one in the user's cache."""

    token: str | None = None
    """Token for the server that `expmap robot` sends to."""

    tile_services: Path | None = None
    """File with the map tile services to offer, instead of the default ones."""


def restrain_threads() -> None:
    """Keep the threads of native libraries from slowing other work down; to be called before they are loaded.

    OpenMP's threads sleep while they wait for each other: by default they wait in a busy loop, which made a
    search thirty times slower when other programs used the cores as well. OpenBLAS has one thread: our
    matrices are small, and with two, a fusion beside other programs took 3.5 times the processor time.
    Existing variables are kept.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # parameters of mallopt(3)
_LARGEST_KEPT, _MOST_KEPT = 32 << 20, 512 << 20  # bytes of one block, and in total


def keep_freed_memory() -> None:
    """Make glibc keep memory that OpenCV and NumPy free, for a process that handles one photo after another.

    Allocating a photo's image pyramid anew each time took a sixth of the time of a build, and of a query.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT)
        libc.mallopt(_M_TRIM_THRESHOLD, _MOST_KEPT)


_HEAPS = {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": "1000000", "MALLOC_TRIM_THRESHOLD_": "4000000"}
"""For glibc. By default each localizing thread keeps its own heap of 64 MB, full of freed arrays: this more
than doubles the memory of all processes, and saves no time."""


def environment_for(native_threads: int | None = None) -> dict[str, str]:
    """Make the environment of a server process: few native threads, and heaps that shrink again.

    The libraries read these variables when they are loaded. Variables that the user has set are kept.

    Args:
        native_threads: Limit of the threads of OpenMP; by default none.
    """
    threads = {"OMP_NUM_THREADS": str(native_threads)} if native_threads else {}
    return threads | _HEAPS | dict(os.environ)


METRICS_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
"""Variable of the Prometheus client: folder through which the processes of a server share their metrics."""


def shares_metrics() -> bool:
    return bool(os.environ.get(METRICS_FOLDER))
