"""Pages of localization, and of the evaluation of a map on its own photos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flask import Blueprint, render_template
from flask_babel import format_decimal, format_percent, format_timedelta
from flask_babel import gettext as _
from flask_babel import lazy_gettext as _l
from markupsafe import Markup

from webapp.core.evaluation.metrics import WITHIN_PX
from webapp.core.geo.types import MapPixel
from webapp.errors import StorageError
from webapp.files.localize.models import usable_features, usable_methods
from webapp.render.charts import ChartWords, error_chart, reliability_chart
from webapp.store import queries
from webapp.store.maps import maps
from webapp.store.operate import job_views
from webapp.store.schema import MapRecord
from webapp.tasks.evaluation import stored as stored_evaluation
from webapp.tasks.evaluation.stored import Miss, StoredEvaluation
from webapp.tasks.localize.calibrate import calibrated_on
from webapp.tasks.localize.index_location import has_landmarks
from webapp.tasks.localize.open_pipeline import can_reconstruct
from webapp.tasks.maps import examples
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.operate.models import missing_second_look
from webapp.web.context import account, library, reading_map, settings
from webapp.web.localize.answers import answer_colours
from webapp.web.maps import state as map_state
from webapp.web.pages import Tab, page
from webapp.web.satellite.layers import offered_layers

blueprint = Blueprint("localize_pages", __name__)
KIND = "evaluate"
"""Kind of the evaluation job."""
_MISSES_SHOWN = 24
_SURE = 0.5
"""Probability from which a wrong answer counts as confident."""


@blueprint.get("/maps/<slug>/localize")
@page(chapter="localize#in-the-browser", tab=Tab(_l("Localize"), "target", order=2))
def localize(slug: str) -> str:
    """Show the page for queries; `?query=ID` opens an earlier answer."""
    with reading_map(slug) as (session, record):
        state = map_state.of_page(session, record, account=account())
        seconds = queries.usual_seconds(session, record)
    return render_template(
        "localize/localize.html",
        usual=None if seconds is None else format_timedelta(max(seconds, 1.0), threshold=1),
        map=record,
        state=state,
        services=offered_layers(),
        features=sorted(usable_features(settings().models)),
        methods=usable_methods(settings().models),
        colours=answer_colours(),
        has_landmarks=has_landmarks(library().cfg(slug)) or can_reconstruct(settings()),
        examples=examples.examples_of(library().cfg(slug)),
        lacks_models=account().is_owner and bool(missing_second_look(settings())),
    )


@dataclass(frozen=True, slots=True)
class ResultLine:
    """A line of the table: name, value, and 95 % interval, which may be empty."""

    words: str
    value: str
    interval: str


@dataclass(frozen=True, slots=True)
class MissedPhoto:
    """A photo that was not localized correctly, with the wrong answer and advice."""

    id: int
    name: str
    thumb: str
    words: str
    advice: str


@dataclass(frozen=True, slots=True)
class Part:
    """One scheme of the evaluation, formatted for the page."""

    title: str
    about: str
    summary: str
    """Quality of the map in one or two sentences."""
    lines: list[ResultLine]
    charts: list[tuple[str, Markup]]
    """Title and SVG of each chart."""
    misses: list[MissedPhoto]
    """The worst first."""
    missed: int
    """Total number of misses, of which `misses` has the first ones."""


@blueprint.get("/maps/<slug>/quality")
@page(
    chapter="measurements#how-to-read-an-evaluation",
    tab=Tab(_l("Quality"), "check", order=5),
)
def quality(slug: str) -> str:
    """Show the last evaluation, and a button for a new one."""
    with reading_map(slug) as (session, record):
        can_edit = maps.role_of(session, record, account=account()) in ("editor", "owner")
        placed = maps.counts(session, record)[1]
        names = {
            photo.path: (photo.id, photo.name, map_state.picture_address(record, photo, kind="thumb"))
            for photo in maps.photos(session, record)
            if not photo.removed
        }
        going = [
            job.id
            for job in job_views.current(session, record.id)
            if job.kind == KIND and job.ended_at is None
        ]
    kept, error = _kept(record)
    with library().database.read() as session:
        changed = bool(kept) and maps.alters_answers(session, record, since=kept[0].revision)
    return render_template(
        "localize/quality.html",
        map=record,
        page={"map": slug, "job": next(iter(going), None)},
        can_edit=can_edit,
        placed=placed,
        kept=kept[0] if kept else None,
        changed=changed,
        parts=[_part(one, names, metres=_metres(record)) for one in kept],
        error=error,
        calibrated=calibrated_on(library().cfg(record.slug)),
    )


def _kept(record: MapRecord) -> tuple[tuple[StoredEvaluation, ...], StorageError | None]:
    try:
        return stored_evaluation.read(library().cfg(record.slug)), None
    except StorageError as error:
        return (), error


def _metres(record: MapRecord) -> float | None:
    """Return the metres per pixel at the centre of the image; None without a georeference."""
    where = georeference(record)
    if where is None:
        return None
    return where.metres_per_pixel(
        MapPixel((record.satellite_width or 0) / 2, (record.satellite_height or 0) / 2)
    )


def _part(kept: StoredEvaluation, names: Mapping[str, tuple[int, str, str]], *, metres: float | None) -> Part:
    figures, words = kept.figures, _chart_words()
    one_out = figures["scheme"] == "leave-one-out"
    radius = figures["place_radius_px"]
    return Part(
        _("On the whole map") if one_out else _("Away from the map's photos"),
        _("Each photo was localized on the map without that photo.")
        if one_out
        else _(
            "Each photo was localized without any photos within %(distance)s of it, "
            "as if taken between the places on the map.",
            distance=_distance(figures["hide_within_px"], metres),
        ),
        _summary(figures, missed=len(kept.misses), metres=metres),
        _lines(figures, metres),
        [
            (words.error_title, error_chart(kept.errors, place_radius_px=radius, words=words)),
            (words.reliability_title, reliability_chart(kept.reliability, words=words)),
        ],
        [
            MissedPhoto(*names[miss.path], _miss_words(miss, metres), _advice(miss))
            for miss in kept.misses
            if miss.path in names
        ][:_MISSES_SHOWN],
        len(kept.misses),
    )


def _summary(figures: dict[str, Any], *, missed: int, metres: float | None) -> str:
    found = str(
        _(
            "%(found)s of %(all)s photos are found to within %(distance)s.",
            found=figures["queries"] - missed,
            all=figures["queries"],
            distance=_distance(figures["place_radius_px"], metres),
        )
    )
    if figures["median_px"] is None:
        return found
    median = _distance(figures["median_px"], metres)
    half = _("Half of the answers are at most %(distance)s off.", distance=median)
    return f"{found} {half}"


def _advice(miss: Miss) -> str:
    """Return advice: a confident wrong answer means that the photo is misplaced, or places look alike."""
    if miss.error_px is not None and miss.probability is not None and miss.probability >= _SURE:
        return str(_("Check its place; other places look similar."))
    return str(_("Add a photo here."))


def _miss_words(miss: Miss, metres: float | None) -> str:
    if miss.error_px is None:
        return str(_("no place found"))
    off = _distance(miss.error_px, metres)
    if miss.probability is None:
        return str(_("%(distance)s off", distance=off))
    return str(
        _(
            "%(distance)s off, though the answer gave its place %(percent)s",
            distance=off,
            percent=format_percent(miss.probability),
        )
    )


def _lines(figures: dict[str, Any], metres: float | None) -> list[ResultLine]:
    within = [
        _share(figures, f"within_{radius}px", _("Within %(distance)s", distance=_distance(radius, metres)))
        for radius in WITHIN_PX
    ]
    median = figures["median_px"]
    kinds = {
        "metric": _("Photos mark where they were taken"),
        "areas": _("Photos mark areas"),
        "schematic": _("A plan that is not to scale"),
        "mixed": _("Some photos mark areas"),
    }
    kind = figures.get("map_kind")  # an evaluation by an earlier version has none
    return [
        *([] if kind is None else [ResultLine(_("Kind of map"), kinds[kind], "")]),
        ResultLine(_("Counts as correct within"), _distance(figures["place_radius_px"], metres), ""),
        *within,
        ResultLine(_("Median error"), "–" if median is None else _distance(median, metres), ""),
        _share(figures, "answered_at_99_precision", _("Answered so surely that 99 of 100 are right")),
        ResultLine(_("Answered “not on this map”"), str(figures["abstained"]), ""),
        ResultLine(_("Photos evaluated"), str(figures["queries"]), ""),
    ]


def _share(figures: dict[str, Any], name: str, words: str) -> ResultLine:
    low_high = figures["intervals_95"].get(name)
    interval = "" if low_high is None else " – ".join(format_percent(value) for value in low_high)
    return ResultLine(words, format_percent(figures[name]), interval)


def _distance(pixels: float, metres: float | None) -> str:
    """Format a distance in metres, followed by pixels; in pixels only if the scale is unknown."""
    text = str(_("%(n)s px", n=round(pixels)))
    if metres is None:
        return text
    length = pixels * metres
    return f"{format_decimal(length, '#,##0.0' if length < 10 else '#,##0')}\u00a0m ({text})"


def _chart_words() -> ChartWords:
    return ChartWords(
        error_title=_("Error curve: share of photos with at most this error"),
        error=_("error of the first answer, map pixels"),
        queries=_("photos"),
        place_radius=_("counts as correct"),
        reliability_title=_("Reliability: share of correct answers by stated probability"),
        stated=_("stated probability of the first answer"),
        right=_("of these correct"),
        diagonal=_("as often right as stated"),
        bin=_("{count} photos: {stated} stated, {right} correct"),
        vertical=_("vertical axis"),
    )
