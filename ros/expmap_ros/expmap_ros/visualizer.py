"""Node `visualizer`: the map with its photos and the newest answer, as a picture and as markers.

Two of these nodes can show one answer on two placements of the same photos: `place_by:=photo` puts a
hypothesis at the position of its best photo on this map, whichever placement was used to localize.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from sensor_msgs.msg import Image
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros import running
from expmap_ros.answers import Form, MapFrame
from expmap_ros.geodesy import Origin
from expmap_ros.managed import ManagedNode
from expmap_ros.messages import rotation
from expmap_ros.parameters import Parameter, file_of, numbers
from expmap_ros.pictures import image_of
from webapp.configuration import load_settings
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.jsonform import answer_from_json
from webapp.files.maps.folder import photo_path, read_map
from webapp.files.photos.photo import read_upright
from webapp.render.colours import probability_colour
from webapp.render.map_picture import draw_map

PARAMETERS = (
    Parameter("map_file", "", "Map to show, a .cfg."),
    Parameter(
        "place_by",
        "position",
        "Where a hypothesis is shown: its position, or its best photo's on this map.",
        choices=("position", "photo"),
    ),
    Parameter("frame_id", "map", "Frame of the markers: x east, y north, metres."),
    Parameter("origin", "", "LAT,LON where x and y are 0; the centre of the map's image."),
    Parameter(
        "metres_per_pixel", 0.0, "Size of a pixel without georeference; 0: no markers.", limits=(0, 1e6)
    ),
)

_PHOTO_M = 1.0
"""Size of a photo's marker."""


class Visualizer(ManagedNode):
    """Subscribes to answers, publishes them on the map; late subscribers get the newest ones."""

    def __init__(self, **options: Any) -> None:
        super().__init__("visualizer", PARAMETERS, **options)
        self.start()

    def configure(self) -> None:
        """Read the map. Raises ParameterError."""
        self._show_map(numbers("origin", self._values["origin"], ("LAT", "LON")))
        self._picture = self.advertise(Image, "~/map", running.KEPT)
        self._markers = self.advertise(MarkerArray, "~/markers", running.KEPT)

    def activate(self) -> None:
        """Show the map, and subscribe to answers."""
        self._show({"hypotheses": [], "off_map_probability": None, "stamp": {}})
        self.listen(String, "/pose_estimator/answer", self._take, quality=running.RESULTS)

    def _show_map(self, origin: tuple[float, ...] | None) -> None:
        path = file_of("map_file", self._values["map_file"])
        self._map = read_map(path)
        image = photo_path(path, self._map.satellite.path)
        self._satellite = read_upright(image, limits=load_settings().photo)
        georeference, satellite = self._map.georeference, self._map.satellite
        if origin is None and georeference is not None:
            origin = georeference.latlon_of(MapPixel(satellite.width / 2, satellite.height / 2))
        self._frame = MapFrame(
            None if origin is None else Origin(*origin), self._values["metres_per_pixel"] or None
        )
        self._places = {e.id: e.position for e in self._map.experiences}

    def _take(self, message: String, _: object) -> None:
        self._show(json.loads(message.data))

    def _show(self, form: Form) -> None:
        header = Header(stamp=Time(**form["stamp"]), frame_id=self._values["frame_id"])
        shown = [self._placed(h) for h in form["hypotheses"] if self._is_here(h)]
        self._picture.publish(image_of(self._drawn(form, shown), header))
        self._markers.publish(MarkerArray(markers=self._marked(shown, header)))

    @property
    def _by_photo(self) -> bool:
        return bool(self._values["place_by"] == "photo")

    def _is_here(self, hypothesis: Form) -> bool:
        return not self._by_photo or any(e in self._places for e in hypothesis["experiences"][:1])

    def _placed(self, hypothesis: Form) -> Form:
        if not self._by_photo:
            return hypothesis
        x, y = self._places[hypothesis["experiences"][0]]
        unknown = dict.fromkeys(("radius_px", "radius_m", "heading_deg"))
        return {**hypothesis, **self._on_earth(x, y), **unknown}

    def _on_earth(self, x: float, y: float) -> dict[str, Any]:
        """Return a position in map pixels and degrees, as the fields of a hypothesis."""
        georeference = self._map.georeference
        lat, lon = (None, None) if georeference is None else georeference.latlon_of(MapPixel(x, y))
        return {"x_px": x, "y_px": y, "lat": lat, "lon": lon}

    def _drawn(self, form: Form, shown: list[Form]) -> Any:
        answer = answer_from_json({**form, "hypotheses": shown})
        return np.asarray(draw_map(self._satellite, self._map, answer=answer).convert("RGB"))

    def _marked(self, shown: list[Form], header: Header) -> list[Marker]:
        points = [self._frame.point(self._on_earth(x, y)) for x, y in self._places.values()]
        known = [Point(x=p[0], y=p[1]) for p in points if p is not None]
        photos = Marker(header=header, ns="experiences", type=Marker.SPHERE_LIST, points=known)
        photos.scale.x = photos.scale.y = photos.scale.z = _PHOTO_M
        photos.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
        photos.pose.orientation.w = 1.0
        markers = [Marker(header=header, action=Marker.DELETEALL), *([photos] if known else [])]
        for number, hypothesis in enumerate(shown):
            markers += self._hypothesis(number, hypothesis, header)
        return markers

    def _hypothesis(self, number: int, hypothesis: Form, header: Header) -> list[Marker]:
        """Return a disc of the 68 % radius, and an arrow in the viewing direction if it is known."""
        point = self._frame.point(hypothesis)
        if point is None:
            return []
        red, green, blue = (part / 255 for part in probability_colour(hypothesis["probability"]))
        radius = self._frame.radius(hypothesis) or 2 * _PHOTO_M
        disc = Marker(header=header, ns="hypotheses", id=number, type=Marker.CYLINDER)
        disc.pose.position.x, disc.pose.position.y = point
        disc.pose.orientation.w = 1.0
        disc.scale.x = disc.scale.y = 2 * radius
        disc.scale.z = _PHOTO_M
        disc.color = ColorRGBA(r=red, g=green, b=blue, a=0.6)
        if hypothesis["heading_deg"] is None:
            return [disc]
        arrow = Marker(header=header, ns="headings", id=number, type=Marker.ARROW)
        arrow.pose.position = disc.pose.position
        arrow.pose.orientation = rotation(math.radians(90.0 - hypothesis["heading_deg"]))
        arrow.scale.x, arrow.scale.y, arrow.scale.z = 4 * _PHOTO_M, _PHOTO_M / 2, _PHOTO_M / 2
        arrow.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        return [disc, arrow]


def main() -> None:
    """Run the node."""
    running.main(Visualizer)


if __name__ == "__main__":
    main()
