"""A local WMS 1.3.0 and WMTS 1.0.0 with an image that has red crosses at known places on the Earth."""

import io
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from urllib.parse import parse_qs, urlsplit

import numpy as np
from PIL import Image
from pyproj import Transformer

from tests.http_server import QuietHandler, running
from tests.tile_server import ARM, RED

_TO_METRES = Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)
WORLD_M = 20037508.342789244

WMS = """<?xml version="1.0" encoding="UTF-8"?>
<WMS_Capabilities version="1.3.0" xmlns="http://www.opengis.net/wms" xmlns:xlink="http://www.w3.org/1999/xlink">
<Service><Name>WMS</Name><Title>Survey
 of the town</Title><OnlineResource xlink:href="{base}"/><MaxWidth>4000</MaxWidth></Service>
<Capability><Request>
<GetCapabilities><Format>text/xml</Format></GetCapabilities>
<GetMap><Format>image/png</Format><Format>image/tiff</Format><Format>image/jpeg</Format>
<DCPType><HTTP><Get><OnlineResource xlink:type="simple" xlink:href="{base}"/></Get></HTTP></DCPType></GetMap>
</Request><Exception><Format>XML</Format></Exception>
<Layer><Title>All</Title><CRS>EPSG:4326</CRS><CRS>EPSG:25833</CRS>
<EX_GeographicBoundingBox><westBoundLongitude>14.2</westBoundLongitude>
<eastBoundLongitude>14.7</eastBoundLongitude><southBoundLatitude>49.9</southBoundLatitude>
<northBoundLatitude>50.2</northBoundLatitude></EX_GeographicBoundingBox>
<Attribution><Title>© Town (CC BY 4.0)</Title></Attribution>
<Layer><Name>degrees</Name><Title>In degrees</Title></Layer>
<Layer><Title>A group without a name</Title><CRS>EPSG:3857</CRS>
<Layer><Name>ortho &amp; more</Name><Title>Aerial\u009b photos</Title>
<MinScaleDenominator>1066.36</MinScaleDenominator>
<Style><Name>default</Name><Title>default</Title></Style></Layer></Layer>
<Layer noSubsets="1"><Name>whole</Name><Title>One picture</Title></Layer></Layer>
<Layer><Name>local</Name><Title>Only local</Title><CRS>EPSG:25833</CRS></Layer>
</Capability></WMS_Capabilities>"""

WMTS = """<?xml version="1.0" encoding="UTF-8"?>
<Capabilities xmlns="http://www.opengis.net/wmts/1.0" xmlns:ows="http://www.opengis.net/ows/1.1"
 xmlns:xlink="http://www.w3.org/1999/xlink" version="1.0.0">
<ows:ServiceIdentification><ows:Title>Tiles</ows:Title></ows:ServiceIdentification>
<ows:ServiceProvider><ows:ProviderName>Town survey</ows:ProviderName></ows:ServiceProvider>
<ows:OperationsMetadata><ows:Operation name="GetTile"><ows:DCP><ows:HTTP>
<ows:Get xlink:href="{base}/rest"><ows:Constraint name="GetEncoding"><ows:AllowedValues>
<ows:Value>RESTful</ows:Value></ows:AllowedValues></ows:Constraint></ows:Get>
<ows:Get xlink:href="{base}/kvp?key=1&amp;"><ows:Constraint name="GetEncoding"><ows:AllowedValues>
<ows:Value>KVP</ows:Value></ows:AllowedValues></ows:Constraint></ows:Get>
</ows:HTTP></ows:DCP></ows:Operation></ows:OperationsMetadata>
<Contents>
<Layer><ows:Title>By address</ows:Title><ows:Identifier>rest</ows:Identifier>
<ows:WGS84BoundingBox><ows:LowerCorner>14.2 49.9</ows:LowerCorner><ows:UpperCorner>14.7 50.2</ows:UpperCorner>
</ows:WGS84BoundingBox>
<Style><ows:Identifier>other</ows:Identifier></Style>
<Style isDefault="true"><ows:Identifier>plain style</ows:Identifier></Style>
<Format>image/png</Format><Dimension><ows:Identifier>Time</ows:Identifier><Default>2026</Default></Dimension>
<TileMatrixSetLink><TileMatrixSet>local</TileMatrixSet></TileMatrixSetLink>
<TileMatrixSetLink><TileMatrixSet>GoogleMapsCompatible</TileMatrixSet></TileMatrixSetLink>
<ResourceURL format="image/png" resourceType="tile"
 template="{tiles}/rest/{{Style}}/{{Time}}/{{TileMatrixSet}}/{{TileMatrix}}/{{TileRow}}/{{TileCol}}.png"/></Layer>
<Layer><ows:Title>By parameters</ows:Title><ows:Identifier>kvp</ows:Identifier>
<Style><ows:Identifier>default</ows:Identifier></Style><Format>image/png</Format>
<TileMatrixSetLink><TileMatrixSet>prefixed</TileMatrixSet><TileMatrixSetLimits>
<TileMatrixLimits><TileMatrix>EPSG:3857:17</TileMatrix></TileMatrixLimits></TileMatrixSetLimits>
</TileMatrixSetLink></Layer>
<Layer><ows:Title>Another grid</ows:Title><ows:Identifier>local</ows:Identifier><Format>image/png</Format>
<TileMatrixSetLink><TileMatrixSet>local</TileMatrixSet></TileMatrixSetLink></Layer>
{sets}</Contents></Capabilities>"""


def matrix_set(name, system, named, *, corner=f"-{WORLD_M} {WORLD_M}", zooms=range(20)):
    """Return a set of tile matrices; `named` makes the name of a matrix of its zoom."""
    matrices = "".join(
        f"<TileMatrix><ows:Identifier>{named(zoom)}</ows:Identifier>"
        f"<ScaleDenominator>{559082264.0287178 / 2**zoom!r}</ScaleDenominator>"
        f"<TopLeftCorner>{corner}</TopLeftCorner>"
        "<TileWidth>256</TileWidth><TileHeight>256</TileHeight>"
        f"<MatrixWidth>{2**zoom}</MatrixWidth><MatrixHeight>{2**zoom}</MatrixHeight></TileMatrix>"
        for zoom in zooms
    )
    system = f"<ows:SupportedCRS>urn:ogc:def:crs:EPSG::{system}</ows:SupportedCRS>"
    return f"<TileMatrixSet><ows:Identifier>{name}</ows:Identifier>{system}{matrices}</TileMatrixSet>"


SETS = (
    matrix_set("local", 25833, str, corner="200000 6000000")
    + matrix_set("GoogleMapsCompatible", 3857, str, zooms=range(19))
    + matrix_set("prefixed", 3857, lambda zoom: f"EPSG:3857:{zoom}")
)


def _metres(lat, lon):
    return _TO_METRES.transform(lon, lat)


class MapServer:
    """`landmarks` are (lat, lon); `answers` replaces answers by path: (status, media type, body)."""

    def __init__(self):
        self.landmarks = []
        self.answers = {}
        self.asked = []
        self.port = None
        self.base = self.tiles = None

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def answer(self, path):
        """Return status, media type and body."""
        self.asked.append(path)
        parts = urlsplit(path)
        if parts.path in self.answers:
            return self.answers[parts.path]
        given = {name.upper(): values[0] for name, values in parse_qs(parts.query, True).items()}
        if given.get("REQUEST") == "GetCapabilities":
            text = WMS if given["SERVICE"] == "WMS" else WMTS
            base, tiles = self.base or f"{self.url}/wms?map=town&amp;", self.tiles or self.url
            if text is WMTS:
                base = self.url
            return 200, "text/xml", text.format(base=base, tiles=tiles, sets=SETS).encode()
        if given.get("REQUEST") == "GetMap":
            return self.get_map(given)
        if parts.path.startswith("/rest/"):
            style, time, name, zoom, row, column = parts.path.removeprefix("/rest/").split("/")
            assert (style, time, name) == ("plain%20style", "2026", "GoogleMapsCompatible")
            return self.tile(int(zoom), int(row), int(column.removesuffix(".png")))
        assert (given["KEY"], given["LAYER"], given["TILEMATRIXSET"]) == ("1", "kvp", "prefixed")
        prefix, zoom = given["TILEMATRIX"].rsplit(":", 1)
        assert (prefix, given["VERSION"], given["STYLE"]) == ("EPSG:3857", "1.0.0", "default")
        return self.tile(int(zoom), int(given["TILEROW"]), int(given["TILECOL"]))

    def get_map(self, given):
        known = {"VERSION": "1.3.0", "WIDTH": "256", "HEIGHT": "256", "STYLES": "", "MAP": "town"}
        assert {name: given[name] for name in known} == known
        box = [float(number) for number in given["BBOX"].split(",")]
        if given["CRS"] == "EPSG:4326":  # the first axis is the latitude
            assert given["LAYERS"] == "degrees"
            south, west, north, east = box
            return self.draw((west, south, east, north), lambda lat, lon: (lon, lat))
        assert (given["LAYERS"], given["CRS"]) == ("ortho & more", "EPSG:3857")
        return self.draw(box, _metres, format=given["FORMAT"])

    def tile(self, zoom, row, column):
        side = 2 * WORLD_M / 2**zoom
        west, north = column * side - WORLD_M, WORLD_M - row * side
        return self.draw((west, north - side, west + side, north), _metres)

    def draw(self, box, plane, *, format="image/png"):
        """Draw the crosses that are in an area, each on the pixel that contains its place."""
        west, south, east, north = box
        pixels = np.full((256, 256, 3), (60, 120, 60), np.uint8)
        for lat, lon in self.landmarks:
            x, y = plane(lat, lon)
            column = int((x - west) / (east - west) * 256 // 1)
            row = int((north - y) / (north - south) * 256 // 1)
            for dx, dy in [(d, 0) for d in range(-ARM, ARM + 1)] + [(0, d) for d in range(-ARM, ARM + 1)]:
                if 0 <= column + dx < 256 and 0 <= row + dy < 256:
                    pixels[row + dy, column + dx] = RED
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, format=format.partition("/")[2])
        return 200, format, buffer.getvalue()


@contextmanager
def serving():
    """Run a server during the block."""
    maps = MapServer()

    class Handler(QuietHandler, BaseHTTPRequestHandler):
        def do_GET(self):
            status, kind, body = maps.answer(self.path)
            self.send_response(status)
            if status in (301, 302):
                self.send_header("Location", body.decode())
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    with running(Handler) as maps.port:
        yield maps
