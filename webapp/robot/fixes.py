"""Localizes a photo on the server."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypedDict, Unpack

from .errors import NotReady
from .uplink import NoResponse, Uplink

_PATIENCE_S = 60.0


class Near(NamedTuple):
    """A circle on the Earth: degrees north and east on WGS 84, metres."""

    lat: float
    lon: float
    radius_m: float


@dataclass(frozen=True, slots=True)
class Fix:
    """Where a photo was taken."""

    # `lat`, `lon`: Degrees north and east, WGS 84; None if the photo was not found on the map.
    lat: float | None
    lon: float | None
    # Variance east, variance north, covariance of the two, square metres; same format as in a pose.
    covariance_m2: tuple[float, float, float] | None
    heading_deg: float | None  # Viewing direction of the camera, degrees clockwise from north
    time_s: float | None  # When it was taken, seconds since 1970, UTC
    map_revision: int  # Of the map that was searched
    photo: str  # SHA-256 of the photo, for the field `photo` of an object
    no_pose: str | None  # Why there is no position; None if there is one
    # The whole response: `hypotheses` with their probabilities, `seconds`, and so on.
    answer: Mapping[str, Any]


class FixFields(TypedDict, total=False):
    """Optional arguments of a fix.

    Attributes:
        near: Approximate position: places in this circle gain probability, but no others are excluded.
        heading_deg: Approximate viewing direction, from a compass: degrees clockwise from north.
        fov_deg: Horizontal field of view of the upright photo; defaults to that from EXIF.
        timeout_s: Maximum time to wait for the answer; defaults to 60 s.
    """

    near: Near
    heading_deg: float
    fov_deg: float
    timeout_s: float


def request_fix(
    server: tuple[str, str],
    mission: int,
    *,
    file: Path | str | BinaryIO,
    time_s: float,
    **more: Unpack[FixFields],
) -> Fix:
    """Localize a photo on the server.

    Args:
        server: Address and token.
        time_s: When it was taken: seconds since 1970, UTC.

    Raises:
        NotReady: The server does not respond, or is busy.
        ExpMapError: The server refuses the request.
    """
    known = {"time": time_s, "heading_deg": more.get("heading_deg"), "fov": more.get("fov_deg")}
    if (near := more.get("near")) is not None:
        known |= {"hint_lat": near.lat, "hint_lon": near.lon, "hint_radius_m": near.radius_m}
    fields = {name: repr(float(value)) for name, value in known.items() if value is not None}
    if isinstance(file, (str, Path)):
        source, name = Path(file).read_bytes(), Path(file).name
    else:
        source, name = file.read(), "photo"
    uplink = Uplink(*server, timeout_s=more.get("timeout_s", _PATIENCE_S))
    with closing(uplink):
        response = uplink.post_file(f"/missions/{mission}/fixes", source, name=name, fields=fields)
    if isinstance(response, NoResponse) or response.status != 200:
        raise response.as_error()
    body = response.body
    try:
        return Fix(
            body["lat"], body["lon"], _flat(body["position_covariance_m2"]), body["heading_deg"],
            body["time"], body["map_revision"], body["photo"], body["no_pose"], body,
        )  # fmt: skip
    except KeyError as error:
        raise NotReady(
            f"the server's answer lacks {error}", hint="check the address of the server"
        ) from error


def _flat(rows: list[list[float]] | None) -> tuple[float, float, float] | None:
    return None if rows is None else (rows[0][0], rows[1][1], rows[0][1])
