"""Photos, positions and shapes as topics for Foxglove: on a WebSocket server, or in an MCAP file.

https://docs.foxglove.dev/docs/visualization/message-schemas describes the messages.
"""

from __future__ import annotations

import functools
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from webapp.core.geo.types import LatLon
from webapp.errors import StorageError, UsageError
from webapp.extras import extra
from webapp.render.colours import RGB

if TYPE_CHECKING:
    from foxglove import Context, MCAPWriter
    from foxglove.messages import LocationFix, Timestamp
    from foxglove.websocket import ChannelView, Client, ServerListener, WebSocketServer

_FRAME = "map"
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class FoxglovePoint:
    latlon: LatLon
    colour: RGB
    # Variance east, variance north, covariance of the two; None if unknown.
    covariance_m2: tuple[float, float, float] | None = None
    heading_deg: float | None = None  # Degrees clockwise from north
    height_m: float | None = None
    about: Mapping[str, str] | None = None  # Key-value pairs that are shown with it


class FoxgloveSink:
    """Topics for Foxglove; a late subscriber is sent the newest message of a topic.

    Args:
        out: MCAP file to write; without it a server listens on `address`.
        address: Host and port; port 0 for any free one.
    """

    def __init__(self, *, out: Path | None = None, address: tuple[str, int] = ("127.0.0.1", 8765)) -> None:
        with extra("foxglove"):
            import foxglove
            from foxglove import channels, messages
        self._sdk, self._kinds, self._messages = foxglove, channels, messages
        self._context: Context = foxglove.Context()
        self._channels: dict[str, Any] = {}
        self._newest: dict[str, Callable[[], None]] = {}
        self._lock = threading.Lock()
        self._writer: MCAPWriter | None = None
        self._server: WebSocketServer | None = None
        if out is None:
            self._server = self._listen(address)
        elif out.exists():
            raise UsageError(
                "the file already exists", where=str(out), hint="choose another name, or delete it"
            )
        else:
            try:
                self._writer = foxglove.open_mcap(out, context=self._context)
            except OSError as error:
                raise StorageError(f"it cannot be written: {error}", where=str(out)) from error

    def _listen(self, address: tuple[str, int]) -> WebSocketServer:
        host, port = address
        try:
            return self._sdk.start_server(
                name="Experience Map",
                host=host,
                port=port,
                context=self._context,
                server_listener=_listener(self._send_newest),
            )
        except (OSError, RuntimeError, ValueError) as error:
            hint = "choose another port, or 0 for any free one"
            raise UsageError(f"cannot listen on {host}:{port}: {error}", where="--port", hint=hint) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def port(self) -> int | None:
        """Port of the server; None for a file."""
        return None if self._server is None else self._server.port

    def image(self, topic: str, data: bytes, *, time_s: float) -> None:
        """Send a picture, encoded as JPEG."""
        message = self._messages.CompressedImage(
            timestamp=self._stamp(time_s), frame_id="camera", data=data, format="jpeg"
        )
        self._log(self._kinds.CompressedImageChannel, topic, message, time_s=time_s)

    def points(self, topic: str, points: Sequence[FoxglovePoint], *, time_s: float) -> None:
        """Send several positions at once, which replace the previous ones."""
        message = self._messages.LocationFixes(fixes=[self._fix(point, time_s) for point in points])
        self._log(self._kinds.LocationFixesChannel, topic, message, time_s=time_s)

    def point(self, topic: str, point: FoxglovePoint, *, time_s: float) -> None:
        """Send the next position of a track."""
        self._log(self._kinds.LocationFixChannel, topic, self._fix(point, time_s), time_s=time_s)

    def shapes(self, topic: str, geojson: str, *, time_s: float) -> None:
        """Send GeoJSON, which replaces the previous one."""
        self._log(self._kinds.GeoJsonChannel, topic, self._messages.GeoJson(geojson=geojson), time_s=time_s)

    def values(self, topic: str, values: Mapping[str, Any], *, time_s: float) -> None:
        """Send an object as JSON."""
        make = functools.partial(self._sdk.Channel, message_encoding="json")
        self._log(make, topic, json.dumps(values).encode("utf-8"), time_s=time_s)

    def close(self) -> None:
        """Stop the server, or finish the file."""
        if self._server is not None:
            self._server.stop()
        if self._writer is not None:
            self._writer.close()

    def _log(self, make: Callable[..., Any], topic: str, message: Any, *, time_s: float) -> None:
        if topic not in self._channels:
            self._channels[topic] = make(topic, context=self._context)
        channel = self._channels[topic]

        def send() -> None:
            channel.log(message, log_time=round(time_s * _NS))

        with self._lock:
            self._newest[topic] = send
        send()

    def _stamp(self, time_s: float) -> Timestamp:
        return self._messages.Timestamp(*divmod(round(time_s * _NS), _NS))

    def _fix(self, point: FoxglovePoint, time_s: float) -> LocationFix:
        made = self._messages
        kinds = made.LocationFixPositionCovarianceType
        east, north, both = point.covariance_m2 or (0.0, 0.0, 0.0)
        red, green, blue = (part / 255 for part in point.colour)
        about = (point.about or {}).items()
        fix: LocationFix = made.LocationFix(
            timestamp=self._stamp(time_s),
            frame_id=_FRAME,
            latitude=point.latlon.lat,
            longitude=point.latlon.lon,
            altitude=point.height_m or 0.0,  # 0 means unknown
            position_covariance=[east, both, 0.0, both, north, 0.0, 0.0, 0.0, 0.0],
            position_covariance_type=kinds.Unknown if point.covariance_m2 is None else kinds.Approximated,
            heading=point.heading_deg,
            color=made.Color(r=red, g=green, b=blue, a=1.0),
            metadata=[made.KeyValuePair(key=key, value=value) for key, value in about],
        )
        return fix

    def _send_newest(self, topic: str) -> None:
        with self._lock:
            send = self._newest.get(topic)
        if send is not None:
            send()


def _listener(subscribed: Callable[[str], None]) -> ServerListener:
    """Make a listener that calls `subscribed` with the topic of each new subscription."""
    with extra("foxglove"):
        from foxglove.websocket import ServerListener

    class _Listener(ServerListener):
        def on_subscribe(self, client: Client, channel: ChannelView) -> None:
            subscribed(channel.topic)

    return _Listener()
