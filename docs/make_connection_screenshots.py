"""Make the pictures of connections: `python -m docs.make_connection_screenshots [NAME ...]`.

Starts the program with the sample map in a temporary library. Drones, people with ATAK, a web server with a
large file and visitors are simulated; what the program does with them is photographed in a browser.
"""

from __future__ import annotations

import base64
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from json import dumps
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from docs.make_screenshots import PICTURES, WIDE, settle, sign_in
from tests.browser.api import Api
from tests.browser.app import App, expmap
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS
from tests.net.range_server import serving
from tests.ports import reserved_port
from webapp.core.geo.types import LatLon
from webapp.files.maps.folder import read_map
from webapp.importing import import_name

TEAM = (("Alfa 1", (2, 3, 4, 5, 6, 7, 8, 9)), ("Alfa 2", (30, 31, 32, 33, 34)), ("K9 Rex", (20, 21, 22, 23)))
"""People of a TAK server, and the photos of the map past which they walk."""

FLIGHT = tuple(range(40, 58))
"""The photos above which a drone flies."""

POSES, STEPS = 120, 40
"""Positions of the drone, and of each of the team, one a second."""

VISITORS = ("query_02.jpg", "query_05.jpg", "query_08.jpg")
"""Photos that visitors give."""

SHOWN = 8
"""Photos of the picture of STAC."""


class Stage(NamedTuple):
    """What the pictures are made of."""

    app: App
    api: Api
    browser: Browser
    cookies: Any
    token: str
    remote: Any  # Serves the remote file

    @property
    def sample(self) -> Path:
        return self.app.library / "sample"

    def places(self) -> list[LatLon]:
        made = read_map(self.sample / "map.cfg")
        assert made.georeference is not None
        return [made.georeference.latlon_of(one.position) for one in made.experiences]

    def mission(self, name: str) -> int:
        return int(self.api.ask("POST", "/missions", data={"name": name, "map": "sample"})["id"])


def main(names: list[str]) -> None:
    """Write the pictures of these names; all, if there are none."""
    browser = find_browser()
    if browser is None:
        raise SystemExit(MISSING)
    with (
        tempfile.TemporaryDirectory() as folder,
        reserved_port() as port,
        serving(b"") as remote,
        sync_playwright() as p,
    ):
        services = Path(folder) / "services.json"
        entry = {
            "name": "Town (PMTiles)",
            "remote": remote.address,
            "attribution": "© Town (made for this picture)",
            "max_zoom": 20,
        }
        services.write_text(dumps([entry]), "utf-8")
        environ = {
            "EXPMAP_TILE_SERVICES": str(services),
            "EXPMAP_REMOTE_ENABLED": "yes",
            "EXPMAP_REMOTE_PRIVATE_HOSTS": "127.0.0.1",
        }
        with App(Path(folder) / "maps", port=port, environ=environ) as app:
            chromium = p.chromium.launch(executable_path=browser, args=list(BROWSER_OPTIONS))
            context = chromium.new_context(base_url=app.url)
            api = sign_in(context, app)
            token = expmap("account", "token", "--name", "pictures", library=app.library).split()[-1]
            stage = Stage(app, api, chromium, context.storage_state(), token, remote)
            time.sleep(65)  # as long as pages show jobs that have ended
            for name in names or PAGES:
                look: dict[str, Any] = {"reduced_motion": "reduce", **WIDE}
                with stage.browser.new_context(base_url=app.url, storage_state=stage.cookies, **look) as tab:
                    page = tab.new_page()
                    PAGES[name](stage, page)
                    settle(page)
                    page.screenshot(path=PICTURES / f"{name}.jpg", type="jpeg", quality=80, scale="css")
            chromium.close()


def show_contributions(stage: Stage, page: Page) -> None:
    """Give photos as a visitor, and open the list of what waits."""
    share = stage.api.ask("POST", "/maps/sample/shares", data={"contribute": True})
    with stage.browser.new_context(base_url=stage.app.url) as stranger:
        visitor = stranger.new_page()
        visitor.goto(f"{share['url']}/map")
        visitor.get_by_test_id("give-consent").check()
        files = [stage.sample / "queries" / name for name in VISITORS]
        visitor.get_by_test_id("give-input").set_input_files(files)
        visitor.get_by_test_id("give").get_by_text("was found").nth(len(files) - 1).wait_for()
    page.goto("/maps/sample/contributions")
    page.get_by_test_id("contribution").nth(len(files) - 1).wait_for()


def show_remote_file(stage: Stage, page: Page) -> None:
    """Choose an area of a remote PMTiles as the image of a new map."""
    file = stage.app.library.parent / "town.pmtiles"
    expmap("connect", "basemaps", stage.sample / "map.cfg", file, library=stage.app.library)
    stage.remote.content = file.read_bytes()
    slug = stage.api.make_map("North gate", satellite=None)
    middle = np.mean(stage.places(), axis=0)
    page.set_viewport_size({"width": 800, "height": 760})
    page.goto(f"/maps/{slug}/image")
    page.get_by_test_id("way-tiles").click()
    page.locator("#tile-goto").fill(f"{middle[0]:.6f}, {middle[1]:.6f}")
    page.keyboard.press("Enter")
    for _ in range(2):
        page.locator("#tile-map").get_by_role("button", name="Zoom in").click()
        page.wait_for_timeout(500)
    page.get_by_test_id("tile-view").click()
    page.get_by_test_id("tile-zoom").fill("20")
    page.locator("#choose").scroll_into_view_if_needed()


def show_qgis(stage: Stage, page: Page) -> None:
    """Open the export menu of the editor at the project of QGIS."""
    page.goto("/maps/sample/edit")
    page.locator("[data-testid=map-canvas] canvas").wait_for()
    page.locator("summary[aria-label='More export formats']").click()
    page.locator("a[href$='export.qgz']").hover()


def show_stac(stage: Stage, page: Page) -> None:
    """Show what pystac-client reads of the sample."""
    client: Any = import_name("pystac_client:Client")  # only the tests need it
    signed = {"Authorization": f"Bearer {stage.token}"}
    catalog = client.open(f"{stage.app.url}/api/v1/stac", headers=signed)
    items = list(catalog.search(collections=["sample"], max_items=SHOWN).items())
    cells = []
    for item in items:
        answer = page.request.get(item.assets["thumb"].href, headers=signed)
        picture = f"data:image/webp;base64,{base64.b64encode(answer.body()).decode()}"
        lat, lon = item.geometry["coordinates"][::-1]
        said = f"{item.id}\n{lat:.6f}, {lon:.6f}\nview:azimuth {item.properties['view:azimuth']:.0f}°"
        cells.append(f"<figure><img src='{picture}'><figcaption>{escape(said)}</figcaption></figure>")
    count = f"{len(items)} items of {escape(stage.app.url)}/api/v1/stac/collections/sample"
    page.set_viewport_size({"width": 1280, "height": 620})
    head = f"<style>{_STAC_STYLE}</style><pre>{escape(_STAC_CODE)}</pre><p>{count}</p>"
    page.set_content(f"{head}<main>{''.join(cells)}</main>")


def show_tak(stage: Stage, page: Page) -> None:
    """Have positions of people and a marker come from a TAK server into a mission."""
    mission, places = stage.mission("Search with ATAK"), stage.places()
    begin_s = time.time() - STEPS
    events = []
    for name, photos in TEAM:
        way = _along([places[number] for number in photos], count=STEPS)
        events += [_cot(name, "a-f-G-U-C", at, time_s=begin_s + n) for n, at in enumerate(way)]
    spots = (("b-m-p-s-m", "Backpack", 12), ("b-r-f-h-c", "Casualty", 24))
    events += [_cot(name, kind, places[number], time_s=begin_s) for kind, name, number in spots]
    with socket.create_server(("127.0.0.1", 0)) as listening:
        words = ("tak", "receive", str(mission), f"tcp://127.0.0.1:{listening.getsockname()[1]}")
        with _running(*words, "--library", str(stage.app.library)):
            client = listening.accept()[0]
            client.sendall("".join(events).encode())
            _wait(lambda: _poses(stage.api, mission) == len(TEAM) * STEPS)
            client.close()
    page.goto(f"/missions/{mission}")
    page.get_by_test_id("track").nth(len(TEAM) - 1).wait_for()


def show_mavlink(stage: Stage, page: Page) -> None:
    """Fly a simulated drone over the park."""
    vehicle: Any = import_name("tests.connect.mavlink.vehicle:SimulatedVehicle")()  # can be removed
    mission, places = stage.mission("Drone over the park"), stage.places()
    way = _along([places[number] for number in FLIGHT], count=POSES)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    spool = stage.app.library.parent / "spool"
    words = ["mavlink", str(spool), f"udp:127.0.0.1:{port}", "--url", stage.app.url, "--token", stage.token]
    more = ["--mission", str(mission), "--name", "1=Hawk", "--every", "0.2", "--min-move", "0"]
    with _running(*words, *more), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:

        def send(*packets: bytes) -> None:
            for packet in packets:
                sending.sendto(packet, ("127.0.0.1", port))

        _wait(lambda: spool.exists() and any(spool.iterdir()))
        page.goto(f"/missions/{mission}")
        time.sleep(2)
        for n, at in enumerate(way):
            after = way[min(n + 1, len(way) - 1)]
            turn = float(np.degrees(np.arctan2((after.lon - at.lon) * 0.64, after.lat - at.lat))) % 360.0
            send(vehicle.heartbeat(5), vehicle.receiver(accuracy_mm=900), vehicle.charge(63))
            height_m = 230.0 + 25.0 * float(np.sin(np.pi * n / len(way)))
            send(vehicle.position(1000 + 250 * n, at.lat, at.lon, height_m=height_m, heading_deg=turn))
            time.sleep(0.25)
        send(vehicle.text("Low battery: return to launch", 4))
        _wait(lambda: _poses(stage.api, mission) > POSES // 2)
        page.get_by_test_id("robot").first.wait_for()
        page.get_by_test_id("track").first.wait_for()
        page.wait_for_timeout(3000)


def _along(corners: list[LatLon], *, count: int) -> list[LatLon]:
    """Return positions at equal distances along a way."""
    points = np.array([tuple(one) for one in corners])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, way[-1], count)
    return [
        LatLon(float(lat), float(lon))
        for lat, lon in np.column_stack([np.interp(at, way, points[:, axis]) for axis in (0, 1)])
    ]


def _cot(name: str, kind: str, at: LatLon, *, time_s: float) -> str:
    """Write an event of Cursor-on-Target, as ATAK does."""
    made, stale = (
        time.strftime("%Y-%m-%dT%H:%M:%S.000Z", time.gmtime(one)) for one in (time_s, time_s + 600.0)
    )
    uid = f"ANDROID-{name.replace(' ', '-')}"
    return (
        f'<event version="2.0" uid="{uid}" type="{kind}" how="m-g" time="{made}" start="{made}" '
        f'stale="{stale}"><point lat="{at.lat:.7f}" lon="{at.lon:.7f}" hae="9999999.0" ce="4.0" '
        f'le="9999999.0"/><detail><contact callsign="{name}"/></detail></event>'
    )


@contextmanager
def _running(*words: str) -> Iterator[None]:
    """Run a command of `expmap connect` during the block."""
    process = subprocess.Popen([sys.executable, "-m", "webapp", "connect", *words])
    try:
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def _poses(api: Api, mission: int) -> int:
    return sum(track["poses"] for track in api.ask("GET", f"/missions/{mission}")["tracks"])


def _wait(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + 120
    while not holds():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.3)


PAGES: dict[str, Callable[[Stage, Page], None]] = {
    "contributions": show_contributions,
    "mavlink": show_mavlink,
    "qgis": show_qgis,
    "remote-file": show_remote_file,
    "stac": show_stac,
    "tak": show_tak,
}
_STAC_CODE = """\
catalog = pystac_client.Client.open("https://maps.example.org/api/v1/stac", headers=signed)
for item in catalog.search(collections=["sample"]).items():
    show(item.assets["thumb"].href, item.id, item.geometry, item.properties["view:azimuth"])"""
_STAC_STYLE = """\
body { margin: 24px; font: 15px/1.5 system-ui, sans-serif; background: #fff; color: #1c2430 }
pre { margin: 0; padding: 12px 16px; border-radius: 8px; background: #eef1f5 }
main { display: grid; grid-template-columns: repeat(4, 1fr); gap: 16px }
figure { margin: 0; border: 1px solid #d5dbe3; border-radius: 8px; overflow: hidden }
img { display: block; width: 100%; height: 130px; object-fit: cover }
figcaption { padding: 6px 10px; white-space: pre-line; font-size: 13px; line-height: 1.35 }"""


if __name__ == "__main__":
    main(sys.argv[1:])
