"""The jobs of maps, listed in `kinds.py`."""

from __future__ import annotations

from collections import Counter
from typing import Any

from webapp.core.geo.tilegrid import GeoBox
from webapp.errors import NotFound
from webapp.files.localize import adopted
from webapp.files.localize.models import blur_networks, usable_global_descriptor
from webapp.files.maps.folder import read_map
from webapp.jobs.context import Context
from webapp.render import export_file
from webapp.settings import Settings
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of
from webapp.tasks.blur.find import PhotoToSearch, accept_in_library, search_photos
from webapp.tasks.evaluation import evaluate
from webapp.tasks.evaluation import stored as stored_evaluation
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.evaluation.types import EvaluateOptions
from webapp.tasks.exchange import import_map
from webapp.tasks.exchange.import_map import archive_path
from webapp.tasks.find import describe_library
from webapp.tasks.landmarks import photo_pieces
from webapp.tasks.landmarks import stored as stored_places
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.colours import colour_cloud
from webapp.tasks.landmarks.on_demand import reconstruct_part
from webapp.tasks.landmarks.place_rest import suggest_rest
from webapp.tasks.landmarks.reconstruct import reconstruct
from webapp.tasks.landmarks.show_cloud import align_in_library
from webapp.tasks.localize import build_map
from webapp.tasks.localize.adopt_query import independent_photos
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.open_pipeline import make_plan, open_pipeline
from webapp.tasks.localize.plan import MapPlan, OpenOptions
from webapp.tasks.localize.trials import MOST_PHOTOS
from webapp.tasks.maps import export, health
from webapp.tasks.maps.contribute import suggest_later
from webapp.tasks.satellite import display, tiles
from webapp.tasks.satellite.apply import ImageChoice, set_image
from webapp.tasks.satellite.files import removed_if_refused
from webapp.tasks.satellite.tiles import TileRequest
from webapp.tasks.street.add_street import add_street_photos
from webapp.tasks.street.survey import LibraryTarget, PixelBox, StreetRequest, survey_street
from webapp.tasks.video.add_video import WaitingVideo, add_video, waiting_folder
from webapp.tasks.video.cut_video import CutVideoOptions

_NAMED = 100
"""Maximum number of photos or findings named in a result."""


def build_map_index(context: Context) -> dict[str, Any]:
    """Build a map's index and calibration, as `expmap build` does; after an interruption it continues.

    Photos that were added from answers are among the real queries, if people corrected the position or the
    photo's GPS confirms it. At the end, places are suggested for photos that visitors gave before. The
    arguments `features` and `method` override the defaults of the library.
    """
    library, record, asked = context.library, context.map(), context.arguments
    options = OpenOptions(asked.get("method", "auto"), asked.get("features") or "auto")
    plan = make_plan(library.cfg(record.slug), options, settings=context.settings)
    export.export_map(library, record.id)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
        photos = independent_photos(session, record)
    adopted.write(library.cfg(record.slug), photos)
    context.progress.plan(*_stages(plan, placed, settings=context.settings))
    context.progress.note("describing photos")
    report = build_map.build_map(
        library.cfg(record.slug),
        options,
        settings=context.settings,
        progress=context.progress,
    )
    describe_library.describe_map(
        library, record.id, settings=context.settings, writes=context.write, progress=context.progress
    )
    cache = MapCache(library, context.settings)
    suggest_later(cache, record.id, write=context.write, progress=context.progress)
    looks = [report] if report.second is None else [report, report.second]
    unusable = {id: (photo, reason) for look in looks for id, photo, reason in look.index.failed}
    failed = [{"id": id, "photo": photo, "reason": reason} for id, (photo, reason) in unusable.items()]
    return {
        "photos": report.index.photos,
        "computed": report.index.extracted,
        "failed": failed[:_NAMED],
        "features": report.features,
        "method": options.method,
        "seconds": round(sum(r.index.seconds + (r.calibration_seconds or 0.0) for r in looks), 3),
    }


def _stages(plan: MapPlan, placed: int, *, settings: Settings) -> list[int]:
    """List the steps of each stage of a build: extracting features, comparing photos, calibrating.

    Global descriptors, if installed, are an additional stage of the first look, shared by all looks.
    """
    whole = [] if usable_global_descriptor(settings.models) is None else [placed]
    trials = min(placed, MOST_PHOTOS)
    by_network = [placed] if plan.method == "thorough" else []
    count = len(plan.looks)
    again = [trials] * count if count > 1 else []
    first = [placed, *whole, placed, *by_network, trials]
    further = [placed, *(0 for _ in whole), placed, *by_network, trials]
    return first + further * (count - 1) + again


def describe_all_maps(context: Context) -> dict[str, Any]:
    """Renew the photo vectors of all maps if due; a search over all maps ranks them by these vectors."""
    photos = describe_library.renew_basis(
        context.library, settings=context.settings, writes=context.write, progress=context.progress
    )
    return {"photos": photos}


def evaluate_map(context: Context) -> dict[str, Any]:
    """Localize each of a map's own photos as if it were not on the map, and store the report.

    The argument `limit` is the maximum number of photos, evenly spread over the map.
    """
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    cfg = library.cfg(record.slug)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
    limit: int | None = context.arguments.get("limit")
    context.progress.plan(0, min(placed, MOST_PHOTOS), 2 * min(placed, limit or placed))
    context.progress.note("preparing the map")
    localizer = open_pipeline(cfg, OpenOptions(), settings=context.settings, progress=context.progress)
    done = evaluate.evaluate_self(
        with_hidden_photos(localizer),
        map_folder=cfg.parent,
        options=EvaluateOptions(limit=limit),
        progress=context.progress,
    )
    forms = stored_evaluation.keep(cfg, done)
    return {form["scheme"]: {name: form[name] for name in form if name != "per_query"} for form in forms}


def find_weak_photos(context: Context) -> dict[str, Any]:
    """Find weak photos (too similar, isolated, or with one viewing direction only); store the report."""
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    with library.database.read() as session:
        _, placed = maps.counts(session, record)
    context.progress.plan(0, min(placed, MOST_PHOTOS), 2 * min(placed, health.LIMIT))
    found = health.find_weak_places(
        library.cfg(record.slug), settings=context.settings, progress=context.progress
    )
    return dict(Counter(photo["state"] for photo in found["photos"]))


def suggest_places(context: Context) -> dict[str, Any]:
    """Suggest positions for the photos in a map's tray, and store them next to the index."""
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    cfg = library.cfg(record.slug)
    revision = read_map(cfg).revision
    report = suggest_rest(cfg, settings=context.settings, progress=context.progress)
    stored_places.keep(cfg, report, revision=revision)
    return {"suggested": len(report.suggested), "left": len(report.left)}


def check_pieces_of_map(context: Context) -> dict[str, Any]:
    """Check into which pieces a map's photos fall, and store it for its page."""
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    cfg = library.cfg(record.slug)
    report = photo_pieces.check_pieces(cfg, settings=context.settings, progress=context.progress)
    photo_pieces.keep(cfg, report)
    return {"pieces": len(report.pieces), "alone": len(report.alone)}


def suggest_blurring(context: Context) -> dict[str, Any]:
    """Find faces and number plates in a map's photos, and with the argument `accept` blur them.

    With `least_score`, only detections with at least this score are blurred. Detections are stored, so that
    a repeated job continues where it stopped.
    """
    library, record, settings = context.library, context.map(), context.settings
    with library.database.read() as session:  # the map may have no image yet, and so no .cfg
        rows = [photo for photo in maps.photos(session, record) if not photo.removed]
        photos = [PhotoToSearch(photo.id, photo.path, tuple(boxes_of(photo))) for photo in rows]
    accept = bool(context.arguments.get("accept"))
    networks = blur_networks(settings.models)
    context.progress.note("looking for faces and number plates")
    report = search_photos(
        library.cfg(record.slug),
        photos,
        networks=networks,
        limits=settings.photo,
        progress=context.progress,
        least_score=float(context.arguments.get("least_score", 0.0)) if accept else 0.0,
    )
    blurred: list[int] = []
    failed = list(report.failed)
    if accept:
        context.progress.note("blurring them")
        blurred, refused = accept_in_library(
            library,
            record.id,
            suggested=report.suggested,
            settings=settings,
            progress=context.progress,
            changing=context.changing,
        )
        failed += refused
    return {
        "searched": report.searched,
        "photos": len(report.suggested),
        "boxes": sum(len(one.boxes) for one in report.suggested),
        "blurred": len(blurred),
        "failed": [{"id": one.id, "reason": one.reason} for one in failed[:_NAMED]],
        "missing": list(networks.missing),
    }


def build_landmarks(context: Context) -> dict[str, Any]:
    """Build a map's landmarks by structure from motion, as `expmap landmarks build` does, and align them.

    With the argument `only_lay`, existing landmarks are only aligned with the current map. With `photos`
    (ids), only these photos are reconstructed, for queries among them.
    """
    library, record = context.library, context.map()
    export.export_map(library, record.id)
    cfg, settings = library.cfg(record.slug), context.settings
    result: dict[str, Any] = {}
    if "photos" in context.arguments:
        the_map = read_map(cfg)
        known = {e.id: e for e in the_map.experiences}
        photos = [known[id] for id in context.arguments["photos"] if id in known]
        reconstruct_part(cfg, the_map, photos=photos, settings=settings, progress=context.progress)
        return {"photos": len(photos)}
    if not context.arguments.get("only_lay"):
        the_map = read_map(cfg)
        found = reconstruct(cfg, the_map, settings=settings, progress=context.progress)
        found, _ = adjust_submodels(found, the_map, progress=context.progress)
        colour_cloud(cfg, found, limits=settings.photo, progress=context.progress)
        joined = sum(len(submodel) for submodel in found.submodels)
        result = {"photos": len(found.photos), "joined": joined, "pieces": len(found.submodels)}
    context.progress.note("aligning them with the map")
    align_in_library(library, record)
    return result


def import_map_zip(context: Context) -> dict[str, Any]:
    """Import an uploaded zip archive into an empty map.

    The argument `token` identifies the archive, which is deleted after the import.
    """
    record = context.map()
    archive = archive_path(context.library, context.arguments["token"])
    if not archive.is_file():
        raise NotFound("the uploaded zip no longer exists", hint="upload it again")
    done = import_map.run_into(
        context.library,
        archive,
        map_id=record.id,
        settings=context.settings,
        progress=context.progress,
        writes=context.write,
    )
    archive.unlink(missing_ok=True)
    findings = [{"code": f.code, "message": f.message, "fix": f.fix} for f in done.findings]
    return {"findings": findings[:_NAMED], "left_out": list(done.left_out[:_NAMED])}


def export_map_file(context: Context) -> dict[str, Any]:
    """Export a map to a file for download; the argument `format` is its format."""
    record = context.map()
    blurring = export_file.blurring_of(context.library, record)
    download = export_file.export_map_file(
        context.library,
        record.id,
        form=context.arguments["format"],
        settings=context.settings,
        progress=context.progress,
    )
    name = export_file.keep(context.library, record.slug, download=download, blurring=blurring)
    return {"file": name, "media_type": download.media_type, "revision": record.revision}


def fetch_satellite_tiles(context: Context) -> dict[str, Any]:
    """Set a map's image from a tile service; cached tiles are not fetched again."""
    record = context.map()
    asked = context.arguments
    box = GeoBox(**{name: float(asked[name]) for name in GeoBox._fields})
    fetched = tiles.fetch_tiles(
        context.library,
        record.id,
        request=TileRequest(str(asked["service"]), box, int(asked["zoom"])),
        settings=context.settings,
        progress=context.progress,
    )
    choice = ImageChoice(context.account_id, scale=bool(asked.get("scale")), tray=bool(asked.get("tray")))
    with removed_if_refused(context.library, record.id, name=fetched.new.path):
        applied = set_image(context.changing, record.id, new=fetched.new, choice=choice)
    return {
        "width": fetched.new.image.width,
        "height": fetched.new.image.height,
        "metres_per_pixel": fetched.metres_per_pixel,
        "tiles": fetched.tiles,
        "missing": fetched.missing,
        "attribution": fetched.attribution,
        "warnings": list(fetched.warnings),
        "to_tray": applied.to_tray,
        "from_tray": applied.from_tray,
    }


def fetch_street_photos(context: Context) -> dict[str, Any]:
    """Add street-level photos from a service; photos that the map already has are not downloaded again."""
    asked, settings = context.arguments, context.settings
    area = None if asked["area"] is None else PixelBox(*asked["area"])
    request = StreetRequest(asked["source"], area, asked["panoramas"])
    target = LibraryTarget(context.library, context.map().id, settings=settings, changing=context.changing)
    survey = survey_street(target, request, settings=settings.street, progress=context.progress)
    report = add_street_photos(target, survey, request=request, settings=settings, progress=context.progress)
    failed = [{"id": one.id, "reason": one.reason} for one in report.failed]
    return {
        "found": survey.found,
        "known": survey.known,
        "outside": survey.outside,
        "added": report.added,
        "duplicates": report.duplicates,
        "failed": failed[:_NAMED],
    }


def cut_map_video(context: Context) -> dict[str, Any]:
    """Cut an uploaded video, and add its photos to a map."""
    asked = context.arguments
    folder = waiting_folder(context.library, asked["token"])
    options = CutVideoOptions(
        asked["spread"] / 100.0,
        asked["most"],
        asked["fov_deg"],
        asked["starts_s"],
        None if asked["track"] is None else folder / asked["track"],
    )
    done = add_video(
        context.library,
        context.map().id,
        video=WaitingVideo(folder / asked["clip"], options),
        settings=context.settings,
        progress=context.progress,
        changing=context.changing,
    )
    return {
        "photos": len(done.cut.photos),
        "with_position": done.cut.with_position,
        "added": done.added,
        "duplicates": done.duplicates,
        "notes": list(done.cut.notes),
        "failed": [{"id": name, "reason": reason} for name, reason in done.failed[:_NAMED]],
    }


def make_satellite_tiles(context: Context) -> dict[str, Any]:
    """Make display tiles for a map's large image if it has none yet."""
    made = display.make_tiles(
        context.library, context.map().id, settings=context.settings, progress=context.progress
    )
    return {"tiles": made}
