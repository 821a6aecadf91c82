"""Make the screenshots of the documentation: `python -m docs.make_screenshots`.

Starts the program with the sample map in a temporary library, and photographs its pages in a browser: wide,
and on a phone. A robot that never was makes a round through the park, and is corrected by its receiver
and by photos of the sample. A few photos are put back into the tray, so that there is something to do.
"""

from __future__ import annotations

import csv
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from aiosmtpd.controller import Controller
from aiosmtpd.handlers import Sink
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from benchmarks import derived_maps
from docs.drawn_floors import SHOWN, SLUG, make_floors
from docs.simulated_mission import Round
from docs.simulated_survey import survey
from tests.browser.api import Api
from tests.browser.app import App
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS
from tests.ports import reserved_port
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.model import Map
from webapp.core.mapmodel.panorama import band
from webapp.files.maps.folder import read_map
from webapp.importing import import_name

PICTURES = Path(__file__).resolve().parent / "pictures"
WIDE = {"viewport": {"width": 1280, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
LOOKS: dict[str, dict[str, Any]] = {
    "": WIDE,
    "-phone": {**PHONE, "device_scale_factor": 2},
}
PANORAMAS = "panoramas"
"""A map of panoramas, which a robot with six cameras took in the park."""

JOINED = "panorama-joined.jpg"
"""Picture of one of them."""

AREAS = "park-areas"
"""A map of the same photos, gathered into areas."""

PAGES = {
    "maps": ("/", ("",)),
    "edit": ("/maps/sample/edit", ("", "-phone")),
    "view": ("/maps/sample/view?photo=20", ("", "-phone")),
    "image": ("/maps/sample/image", ("",)),
    "place-rest": ("/maps/sample/edit", ("",)),
    "next-photos": ("/maps/sample/edit", ("",)),
    "landmarks": ("/maps/sample/landmarks", ("",)),
    "landmarks-above": ("/maps/sample/landmarks", ("",)),
    "control-points": ("/maps/sample/control-points", ("",)),
    "panorama": (f"/maps/{PANORAMAS}/edit?photo=1", ("", "-phone")),
    "panorama-mask": (f"/maps/{PANORAMAS}/edit?photo=1", ("",)),
    "floors": (f"/maps/{SLUG}/edit?photo={SHOWN}", ("",)),
    "localize": ("/maps/sample/localize", ("", "-phone")),
    "localize-areas": (f"/maps/{AREAS}/localize", ("",)),
    "missions": ("/missions", ("",)),
    "mission": ("/missions/1", ("", "-phone")),
    "mission-import": ("/missions/1", ("",)),
    "mission-areas": ("/missions/3", ("",)),
    "events": ("/account/events", ("",)),
    "field-forms": ("/account/forms", ("",)),
    "photo-libraries": ("/account/libraries", ("",)),  # the last: photos come onto the sample map
    "sign-in": ("/account/oidc", ("",)),
}
SPOTS = {"kerb, east": 6, "kerb, north": 20, "kerb, west": 30, "manhole": 52}
"""Names of control points, and the photo in front of which each is on the ground."""

AHEAD_M, DOWN_M = 6.0, 1.6
"""How far in front of that camera, and below it."""

QUERY = "queries/query_02.jpg"
"""Photo of the sample that is asked about."""

STOPS = 5
"""Panoramas of the robot."""

USED_DEG = 36.0
"""Below and above the horizon, all of its cameras look there."""

IN_TRAY = range(40, 46)
"""Photos of the sample that are shown as not placed yet."""

SEEN = (
    ("bench 1", "bench", 20, 0.93),
    ("bench 2", "bench", 40, 0.88),
    ("deer", "animal", 26, 0.71),
    ("walker", "person", 34, 0.97),
    ("fallen tree", "tree", 8, 0.82),
    ("notice board", "sign", 2, 0.99),
)
"""Objects of the mission: name, class, the photo of the map where it is, and how sure the robot is."""

START_PX = (-95, 20)
"""Where the imported robot starts, from the middle of the picture."""

OTHERS = ("Morning round, north gate", "Search along the pond")
"""Names of further missions in the list, which go the same way a part of it."""

DRAWN: tuple[dict[str, Any], ...] = (
    {
        "kind": "area",
        "name": "Around the pond",
        "points": ((0.2, 0.28), (0.47, 0.28), (0.47, 0.55), (0.2, 0.6)),
    },
    {
        "kind": "area",
        "name": "Gardens in the north",
        "points": ((0.06, 0.04), (0.95, 0.04), (0.95, 0.17), (0.06, 0.22)),
    },
    {
        "kind": "area",
        "name": "East lawn",
        "points": ((0.65, 0.42), (0.84, 0.36), (0.84, 0.62), (0.68, 0.72)),
        "assigned": "Team 2",
    },
    {"kind": "line", "name": "Fence, closed", "points": ((0.03, 0.94), (0.3, 0.94))},
    {"kind": "marker", "name": "Command post", "points": ((0.72, 0.88),)},
)
"""Drawn on the last of them, the first area as searched; points are fractions of the image's size."""


def main() -> None:
    """Write all screenshots."""
    browser = find_browser()
    if browser is None:
        raise SystemExit(MISSING)
    with (
        tempfile.TemporaryDirectory() as folder,
        reserved_port() as port,
        receiving() as environ,
        providing() as provider,
        App(Path(folder) / "maps", port=port, environ=environ | provider) as app,
        sync_playwright() as p,
    ):
        chromium = p.chromium.launch(executable_path=browser, args=list(BROWSER_OPTIONS))
        context = chromium.new_context(base_url=app.url)
        api = sign_in(context, app)
        make_missions(api, app)
        fill_tray(api)
        suggest_places(api)
        add_control_points(api, app)
        plan_photos(api)
        import_areas(api, app.library / "sample", scratch=Path(folder) / "areas")
        make_panoramas(api, app.library / "sample", scratch=Path(folder) / "survey")
        make_floors(api, app.library / "sample")
        choose_events(api, environ)
        add_groups(context, chromium, home=app.url)
        time.sleep(65)  # as long as pages show jobs that have ended
        for name, (path, looks) in PAGES.items():
            for look in looks:
                shoot(
                    chromium, app, context.storage_state(), path=path, name=f"{name}{look}", look=LOOKS[look]
                )
        chromium.close()


def sign_in(context: BrowserContext, app: App) -> Api:
    """Sign in, and wait for the sample and its index."""
    page = context.new_page()
    page.goto(app.sign_in)
    page.get_by_test_id("sign-in").click()
    page.wait_for_url(f"{app.url}/")
    api = Api(context)
    while api.call("GET", "/maps/sample").status == 404:
        time.sleep(0.5)
    api.wait_for_jobs("sample")
    return api


def import_areas(api: Api, sample: Path, *, scratch: Path) -> None:
    """Gather the photos of the sample into the quarters of its image, and import that as another map."""
    table = derived_maps.read(sample)
    middle = np.array(table.size) / 2.0
    quarter = np.round(middle + np.sign(table.position - middle) * middle / 2.0)
    derived_maps.write(replace(table, position=quarter), scratch)
    cfg, image = scratch / "map.cfg", read_map(sample / "map.cfg").satellite.path
    shutil.copy(sample / image, scratch / image)
    head, _, rest = cfg.read_text("utf-8").partition("\n")
    cfg.write_text(";".join([image, *head.split(";")[1:]]) + "\n" + rest, "utf-8")
    archive = Path(shutil.make_archive(str(scratch), "zip", scratch))
    file = {"name": f"{AREAS}.zip", "mimeType": "application/zip", "buffer": archive.read_bytes()}
    api.ask("POST", "/maps/import", multipart={"file": file, "name": AREAS})
    api.wait_for_jobs(AREAS)


def make_panoramas(api: Api, sample: Path, *, scratch: Path) -> None:
    """Make a map of the panoramas of a robot, masked where not all of its cameras look."""
    made = read_map(sample / "map.cfg")
    assert made.georeference is not None
    photos = survey(scratch, made.georeference, stops=STOPS)
    slug = api.make_map(
        "Panoramas",
        satellite=sample / "satellite.png",
        corners=sample / "corners.json",
        photos=[one.path for one in photos],
    )
    places = [
        {"id": id, "x_px": one.at.x, "y_px": one.at.y, "heading_deg": one.heading_deg}
        for id, one in enumerate(photos)
    ]
    masked = [box._asdict() for box in band(lowest_deg=USED_DEG, highest_deg=USED_DEG)]
    masks = [{"id": id, "panorama": {"masked": masked}} for id in range(len(photos))]
    for kind, changes in (("place", places), ("panorama", masks)):
        api.ask("PATCH", f"/maps/{slug}/experiences", data={"kind": kind, "changes": changes})
    api.wait_for_jobs(slug)
    with Image.open(photos[1].path) as picture:
        width, height = picture.size
        strip = picture.crop((0, height // 4, width, height - height // 4))
        strip.resize((1280, 320), Image.Resampling.LANCZOS).save(PICTURES / JOINED, quality=85)


def fill_tray(api: Api) -> None:
    """Take a few photos off the image."""
    changes = [{"id": id, "x_px": None, "y_px": None} for id in IN_TRAY]
    api.ask("PATCH", "/maps/sample/experiences", data={"kind": "unplace", "changes": changes})
    api.wait_for_jobs("sample")


def suggest_places(api: Api) -> None:
    """Have places suggested for the photos in the tray, which makes the landmarks, too."""
    api.ask("POST", "/maps/sample/place-rest")
    api.wait_for_jobs("sample")
    api.ask("GET", "/maps/sample/landmarks")  # a job aligns them with the map
    api.wait_for_jobs("sample")


def plan_photos(api: Api) -> None:
    """Evaluate the map on its own photos, and plan where the next ones are to be taken."""
    api.ask("POST", "/maps/sample/evaluation", data={"limit": 60})
    api.wait_for_jobs("sample")
    api.ask("POST", "/maps/sample/photo-plan", data={"spots": 10})


def add_control_points(api: Api, app: App) -> None:
    """Click points on the ground in photos that look there, as the landmarks have it."""
    georeference = read_map(app.library / "sample" / "map.cfg").georeference
    cloud = api.ask("GET", "/maps/sample/landmarks")
    assert georeference is not None
    frame = LocalFrame(LatLon(*cloud["origin"]))
    cameras = {camera["id"]: camera for camera in cloud["cameras"]}
    for n, (name, number) in enumerate(SPOTS.items()):
        camera = cameras.get(number) or cloud["cameras"][n]
        ahead = np.array(camera["rotation"])[2] * (1.0, 1.0, 0.0)
        spot = np.array(camera["at"]) + AHEAD_M * ahead / np.linalg.norm(ahead) - (0.0, 0.0, DOWN_M)
        clicks = [click for one in cameras.values() if (click := seen_in(one, spot)) is not None][:4]
        ((lat, lon),) = frame.latlon_from_enu(spot[None, :2])
        at = georeference.pixel_of(LatLon(lat, lon))
        point = {"x_px": at.x + 0.4 * n, "y_px": at.y - 0.3 * n, "accuracy_m": 0.05, "photos": clicks}
        api.ask("PUT", f"/maps/sample/landmarks/control-points/{name}", data=point)
    api.wait_for_jobs("sample")


def seen_in(camera: dict[str, Any], spot: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float] | None:
    """Say where a photo shows a spot; None where it does not, or where it is far away."""
    right, down, front = np.array(camera["rotation"]) @ (spot - camera["at"])
    if not 3.0 < front < 15.0:
        return None
    x = 0.5 + camera["focal_px"] * right / front / camera["width"]
    y = 0.5 + camera["focal_px"] * down / front / camera["height"]
    return {"id": camera["id"], "x": x, "y": y} if 0.05 < x < 0.95 and 0.05 < y < 0.95 else None


def make_missions(api: Api, app: App) -> None:
    """Send the rounds of the robot, localize its photos, and fuse its tracks."""
    sample = app.library / "sample"
    made = read_map(sample / "map.cfg")
    assert made.georeference is not None
    places = [made.georeference.latlon_of(one.position) for one in made.experiences]
    drive = Round(places)
    poses = drive.poses()
    mission = send(api, "Round of the rover in the park", [*poses, *seen(drive, places), {"type": "end"}])
    for n, name in enumerate(OTHERS):
        other = send(api, name, [one for one in poses if one["source"] == "gps"][: 60 + 30 * n])
    draw(api, other, made)
    with (sample / "queries.csv").open(newline="", encoding="utf-8") as file:
        queries = list(csv.DictReader(file, delimiter=";"))
    for query in queries[1:8:2]:
        photo = sample / query["path"]
        place = made.georeference.latlon_of(MapPixel(float(query["x"]), float(query["y"])))
        form = {
            "file": {"name": photo.name, "mimeType": "image/jpeg", "buffer": photo.read_bytes()},
            "time": str(drive.time_at(place)),
        }
        api.ask("POST", f"/missions/{mission}/fixes", multipart=form, timeout=120_000)
    api.ask("POST", f"/missions/{mission}/fuse")
    while not api.call("GET", f"/missions/{mission}/fusion").ok:
        time.sleep(0.5)


def send(api: Api, name: str, records: list[dict[str, Any]]) -> int:
    """Make a mission on the sample and send it, as a robot does; gives its number."""
    mission = int(api.ask("POST", "/missions", data={"name": name, "map": "sample"})["id"])
    batch = {"sender": "robot", "first": 0, "records": records}
    api.ask("POST", f"/missions/{mission}/batches", data=batch)
    return mission


def draw(api: Api, mission: int, made: Map) -> None:
    """Draw areas, a line and a marker on a mission."""
    size = np.array((made.satellite.width, made.satellite.height))
    assert made.georeference is not None
    for drawing in DRAWN:
        pixels = [MapPixel(*(size * point)) for point in drawing["points"]]
        points = [tuple(made.georeference.latlon_of(pixel)) for pixel in pixels]
        added = api.ask("POST", f"/missions/{mission}/drawings", data={**drawing, "points": points})
        if drawing is DRAWN[0]:
            api.ask("PATCH", f"/missions/{mission}/drawings/{added['id']}", data={"searched": True})


def seen(drive: Round, places: list[LatLon]) -> list[dict[str, Any]]:
    """Objects along the way, each seen when the robot was there."""
    return [
        {
            "type": "object",
            "id": name,
            "class": kind,
            "time": drive.time_at(places[number]) + 4 * n,
            "lat": places[number].lat + 2e-5 + n * 2e-6,
            "lon": places[number].lon + 2e-5,
            "confidence": sure,
        }
        for name, kind, number, sure in SEEN
        for n in range(2)
    ]


@contextmanager
def receiving() -> Iterator[dict[str, str]]:
    """Run a webhook and a mail server on this machine; yield the settings with which messages go there."""
    hook: Any = import_name("tests.connect.events.conftest:Hook")()  # that connection can be removed
    with reserved_port() as port:
        mail = Controller(Sink(), hostname="127.0.0.1", port=port)
        mail.start()
        yield {
            "EXPMAP_EVENTS_PRIVATE_HOSTS": "127.0.0.1",
            "EXPMAP_LIBRARIES_PRIVATE_HOSTS": "127.0.0.1",
            "EXPMAP_MAIL_HOST": "127.0.0.1",
            "EXPMAP_MAIL_PORT": str(port),
            "EXPMAP_MAIL_SECURITY": "none",
            "EXPMAP_MAIL_SENDER": "maps@example.org",
            "HOOK": hook.url.replace("/hook", "/alarm"),
        }
        mail.stop()
        hook.close()


def choose_events(api: Api, environ: dict[str, str]) -> None:
    """Add a webhook, with a message that was sent, and an address that is not confirmed yet."""
    hook = {"kind": "webhook", "address": environ["HOOK"], "events": ["robot.silent", "robot.heard"]}
    receiver = api.ask("POST", "/account/events", data=hook)["id"]
    api.ask("POST", f"/account/events/{receiver}/test")
    mail = {"kind": "mail", "address": "alarm@example.org", "events": ["robot.silent", "job.failed"]}
    api.ask("POST", "/account/events", data=mail)
    time.sleep(5)


@contextmanager
def providing() -> Iterator[dict[str, str]]:
    """Run an OpenID Connect provider on this machine; yield the settings by which it is used."""
    tools = "tests.connect.oidc.provider"  # that connection can be removed
    with import_name(f"{tools}:serving")() as provider:
        provider.user = {"sub": "7f3c-41", "name": "Ranger 12", "email": "ranger12@example.org"}
        yield {
            "EXPMAP_OIDC_ISSUER": provider.issuer,
            "EXPMAP_OIDC_CLIENT_ID": import_name(f"{tools}:CLIENT"),
            "EXPMAP_OIDC_CLIENT_SECRET": import_name(f"{tools}:SECRET"),
            "EXPMAP_OIDC_NAME": "Ranger ID",
        }


def add_groups(context: BrowserContext, browser: Browser, *, home: str) -> None:
    """Fill the table of groups, and have somebody wait for an account."""
    stranger = browser.new_context(base_url=home)
    stranger.new_page().goto("/oidc/start")
    stranger.close()
    page = context.new_page()
    for group, role in (("admins", "owner"), ("rangers", "editor 1"), ("volunteers", "viewer 1")):
        page.goto("/account/oidc")
        page.locator("#group").fill(group)
        page.locator("#role").select_option(role)
        page.locator("#role").locator("xpath=ancestor::form").get_by_role("button").click()
        page.wait_for_load_state()
    page.close()


def shoot(browser: Browser, app: App, cookies: Any, *, path: str, name: str, look: dict[str, Any]) -> None:
    """Photograph a page when it has come to rest."""
    context = browser.new_context(base_url=app.url, storage_state=cookies, reduced_motion="reduce", **look)
    page = context.new_page()
    page.goto(path)
    if "/edit" in path:
        page.locator("[data-testid=map-canvas] canvas").wait_for()
    if path.endswith("/localize"):
        page.get_by_test_id("query-input").set_input_files(app.library / "sample" / QUERY)
        page.get_by_test_id("hypothesis").first.wait_for()
    if path.endswith("/landmarks"):
        look_at_landmarks(page, from_above=name.endswith("-above"))
    if path == "/missions":
        page.get_by_test_id("mission").first.wait_for()
    if name == "place-rest":
        page.locator("#place-menu summary").click()
        page.locator("#place-the-rest").click()
        page.get_by_test_id("suggested-photo").first.wait_for()
    if name == "next-photos":
        page.locator("#add-menu summary").click()
        page.locator("#plan-button").click()
        page.get_by_test_id("plan-spot").first.wait_for()
    if "/panoramas/" in path:
        page.locator("#current-frame .panorama__canvas").wait_for()
    if name == "panorama-mask":
        page.locator("#current-more").evaluate("more => { more.open = true; }")
        page.locator("#current-panorama").click()
        page.get_by_role("dialog").wait_for()
    if name == "control-points":
        page.locator("[data-testid=residuals] tr").first.wait_for()
        shown = page.locator("#photo option").filter(has_text="✓").first
        page.locator("#photo").select_option(value=shown.get_attribute("value"))
    if name == "mission-import":
        preview_import(page)
    if name == "photo-libraries":
        link_album(page, app)
    if name == "field-forms":
        choose_export(page)
    if name == "mission-areas":
        page.get_by_test_id("tab-areas").click()
        page.get_by_test_id("coverage").first.wait_for()
    settle(page)
    PICTURES.mkdir(exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}.jpg", type="jpeg", quality=80, scale="css")
    context.close()


def look_at_landmarks(page: Page, *, from_above: bool) -> None:
    """Choose a camera in space, or look at the heights from above."""
    page.locator("[data-testid=scene][data-points]").wait_for()
    if from_above:
        page.get_by_role("button", name="From above").click()
        page.get_by_label("Display", exact=True).click()
        page.locator("#colour").select_option("height")
        page.keyboard.press("Escape")
    else:
        page.locator("#photo").select_option(index=25)


def preview_import(page: Page) -> None:
    """Choose a track in metres, and say where it starts and which way the robot looked."""
    turns = 0.9 * np.sin(np.arange(160) / 22.0)
    xy = np.column_stack([np.cos(turns), np.sin(turns)]).cumsum(axis=0) * 0.35
    poses = [
        f"{1_777_629_600 + n} {x:.2f} {y:.2f} 0 0 0 {np.sin(turn / 2):.4f} {np.cos(turn / 2):.4f}"
        for n, (turn, (x, y)) in enumerate(zip(turns, xy, strict=True))
    ]
    text = "\n".join(poses).encode()
    page.get_by_role("button", name="Import").first.click()
    file = page.get_by_test_id("track-file")
    file.set_input_files({"name": "rover.tum", "mimeType": "text/plain", "buffer": text})
    page.get_by_test_id("import-hint").wait_for()
    settle(page)
    box = page.get_by_test_id("import-picture").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2 + START_PX[0], box["y"] + box["height"] / 2 + START_PX[1]
    page.mouse.click(x, y)
    page.mouse.click(x + 60, y - 25)


def link_album(page: Page, app: App) -> None:
    """Connect a stand-in of Immich, whose album has photos of the sample, and link the album with the map."""
    made: Any = import_name("tests.connect.libraries.immich_server:ImmichServer")  # can be removed
    shot: Any = import_name("tests.connect.libraries.immich_server:Shot")
    serving: Any = import_name("tests.connect.libraries.immich_server:serving")
    files = sorted((app.library / "sample" / "queries").glob("*.jpg"))
    server = made([shot(file.stem, file=file.read_bytes()) for file in files])
    server.albums = {next(iter(server.albums)): "Autumn in the park"}
    with serving(server):
        page.locator("#address").fill(server.url)
        page.locator("#key").fill(server.key)
        page.get_by_role("button", name="Connect", exact=True).click()
        page.get_by_test_id("link-album").locator("#map").select_option("sample")
        page.get_by_role("button", name="Add its photos").click()
        while page.get_by_text(f"{len(files)} photos").count() == 0:
            page.wait_for_timeout(500)
            page.goto("/account/libraries")


def choose_export(page: Page) -> None:
    """Choose a table and the photos of a form."""
    for field, name in (("#file", "survey.csv"), ("#media", "media.zip")):
        chosen: Any = {"name": name, "mimeType": "application/octet-stream", "buffer": b"-"}
        page.locator(field).set_input_files(chosen)


def settle(page: Page) -> None:
    """Wait for the pictures in the page."""
    page.wait_for_timeout(1500)
    page.wait_for_function("() => [...document.images].every(one => one.complete || one.loading === 'lazy')")


if __name__ == "__main__":
    main()
