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
    """Where a photo was taken.

    Attributes
    ----------
    lat, lon : float or None
        Degrees north and east, WGS 84; None where the photo was not found on the map.
    covariance_m2 : tuple of 3 floats, or None
        Variance east, variance north, covariance of the two, square metres: as a pose has it.
    heading_deg : float or None
        Where the camera looked, degrees clockwise from north.
    time_s : float or None
        When it was taken, seconds since 1970, UTC.
    map_revision : int
        Of the map that was asked.
    photo : str
        SHA-256 of the photo: `photo` of an object.
    no_pose : str or None
        Why there is no position; None where there is one.
    answer : mapping
        The whole answer of the server: `hypotheses` with their probabilities, `seconds`, and so on.
    """

    lat: float | None
    lon: float | None
    covariance_m2: tuple[float, float, float] | None
    heading_deg: float | None
    time_s: float | None
    map_revision: int
    photo: str
    no_pose: str | None
    answer: Mapping[str, Any]


class FixFields(TypedDict, total=False):
    """What else may be known of a photo.

    Attributes
    ----------
    near : Near
        About where it was taken: only photos of the map in this circle are searched.
    heading_deg : float
        About where the camera looked, by a compass: degrees clockwise from north.
    fov_deg : float
        Horizontal field of view of the upright photo; from EXIF where it is not given.
    timeout_s : float
        Wait so long for the answer; a minute where it is not given.
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

    Parameters
    ----------
    server : tuple of str
        Address and token.
    time_s : float
        When it was taken: seconds since 1970, UTC.

    Raises
    ------
    NotReady
        The server does not answer, or not now.
    ExpMapError
        The server refuses.
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
