"""`expmap localize`: find out where photos were taken."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
from PIL import Image

from webapp.cli import exitcodes
from webapp.cli.build import report_failed
from webapp.cli.options import (
    MAP_FILE,
    check_sequence,
    chosen_settings,
    fov_option,
    index_options,
    map_options,
    open_options,
    sequence_options,
)
from webapp.cli.progressbar import terminal_progress
from webapp.core.geo.floors import Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.hypotheses.jsonform import answer_to_json, failure_to_json
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.core.hypotheses.verdict import sentence_of, verdict_of
from webapp.errors import MapError, PhotoError, StorageError, UsageError
from webapp.files.localize.models import second_look_features
from webapp.render.answer_pictures import map_picture, match_picture
from webapp.settings import keep_freed_memory
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.sequence import SequenceFilter, smooth_sequence
from webapp.tasks.localize.sequence import by_time as by_time_of_capture

_HEAD = (
    *("", "probability", "floor", "x", "y", "radius", "heading"),
    *("latitude", "longitude", "inliers", "photos"),
)


def answer_text(
    answer: Answer, *, query: str, georeference: Georeference | None, floors: Sequence[Floor] = ()
) -> str:
    """Format the hypotheses as a table, with "not on this map" as a separate line.

    Args:
        query: The photo, as it was given.
        georeference: Georeference of the map; adds latitude, longitude and metres.
        floors: Floors of the map.
    """
    if answer.no_pose is not None:
        where = "no place" if answer.no_pose.blank else "not on this map"
        also = f"\n   {answer.note}" if answer.note else ""
        return f"{query}: {where} ({answer.no_pose.reason}){also}"
    names = {floor.id: floor.name for floor in floors}
    rows = [_HEAD, *(_row(h, georeference, floors=names) for h in answer.hypotheses)]
    shown = [i for i in range(len(_HEAD)) if i == 0 or any(r[i] for r in rows[1:])]
    width = [max(len(r[i]) for r in rows) for i in shown]
    lines = ["  ".join(r[i].rjust(w) for i, w in zip(shown, width, strict=True)) for r in rows]
    if answer.other_probability >= 0.005:
        lines.append(f"   {percent(answer.other_probability)} other places on this map")
    if answer.off_map_probability is not None:
        lines.append(f"   {percent(answer.off_map_probability)} not on this map")
    if answer.note:
        lines.append(f"   {answer.note}")
    return "\n".join([f"{query}: {_verdict(answer)}", *lines])


def _verdict(answer: Answer) -> str:
    """Return the verdict in the form that follows "PHOTO: "."""
    sentence = sentence_of(answer).removesuffix(".")
    return sentence[0].lower() + sentence[1:]


def _row(
    hypothesis: Hypothesis, georeference: Georeference | None, *, floors: Mapping[int, str]
) -> tuple[str, ...]:
    position, radius, heading = hypothesis.position, hypothesis.radius_px, hypothesis.heading_deg
    lat = lon = ""
    shown = "" if radius is None else f"{radius:.0f} px"
    if georeference is not None:
        latlon = georeference.latlon_of(position)
        lat, lon = f"{latlon.lat:.6f}", f"{latlon.lon:.6f}"
        if radius is not None:
            shown = f"{radius * georeference.metres_per_pixel(position):.1f} m"
    return (
        str(hypothesis.rank),
        percent(hypothesis.probability).strip(),
        floors.get(hypothesis.floor, ""),
        f"{position.x:.0f}",
        f"{position.y:.0f}",
        shown,
        "" if heading is None else f"{heading:.0f}°",
        lat,
        lon,
        "" if hypothesis.inliers is None else str(hypothesis.inliers),
        " ".join(str(e) for e in hypothesis.experiences[:4])
        + (" …" if len(hypothesis.experiences) > 4 else ""),
    )


def percent(probability: float) -> str:
    """Format a probability; only exact values are shown as 0 or 100 %."""
    if 0.0 < probability < 0.01:
        return " <1 %"
    if 0.99 < probability < 1.0:
        return ">99 %"
    return f"{100.0 * probability:3.0f} %"


_FORMATS = (".png", ".jpg", ".jpeg", ".webp")
_PICTURE = click.Path(dir_okay=False, path_type=Path)

_LOOK_CLOSER = (
    "--method thorough can make uncertain answers more certain, at about a second per photo: "
    "expmap models list"
)
_LOOK_AGAIN = "a second look can make uncertain answers more certain; it needs models: expmap models fetch"


@click.command(short_help="Say where photos were taken.")
@click.argument("map_file", metavar="MAP.cfg", type=MAP_FILE)
@click.argument("photos", metavar="PHOTO...", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--top",
    type=click.IntRange(1),
    default=5,
    show_default=True,
    metavar="N",
    help="Maximum number of places.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--matches", type=_PICTURE, metavar="OUT.png", help="Draw the query next to the best photo.")
@click.option("--picture", type=_PICTURE, metavar="OUT.png", help="Draw the hypotheses on the map.")
@sequence_options
@click.option("--by-time", is_flag=True, help="With --sequence: order the photos by their EXIF time.")
@index_options
@fov_option
@map_options
def localize(
    map_file: Path,
    photos: tuple[Path, ...],
    top: int,
    as_json: bool,
    matches: Path | None,
    picture: Path | None,
    sequence: bool,
    speed: float | None,
    smooth: bool,
    by_time: bool,
    **chosen: Any,
) -> None:
    """Localize photos: ranked places with probabilities, or "not on this map".

    With several photos the pictures are numbered: OUT-1.png, OUT-2.png and so on.
    """
    for option, path in (("--matches", matches), ("--picture", picture)):
        _refuse_unwritable(path, option)
    if picture is not None and picture == matches:
        raise UsageError("must not be the file of --matches", where="--picture", hint="choose another file")
    check_sequence(sequence, {"--speed": speed is not None, "--smooth": smooth, "--by-time": by_time})
    keep_freed_memory()
    settings = chosen_settings(map_file, chosen)
    steps: dict[Path, float] = {}
    if by_time:
        photos, steps = by_time_of_capture(photos, limits=settings.photo)
    with terminal_progress("photos") as progress:
        pipeline = open_pipeline(
            map_file, open_options(chosen), settings=settings, progress=progress, fov_deg=chosen["fov"]
        )
        localize_photo: Callable[..., Answer] = partial(pipeline.localize, on_first=_show_first)
        if smooth:
            smoothed = smooth_sequence(pipeline, photos, progress=progress, speed_px=speed, steps=steps)
            localize_photo = smoothed.localize
        elif sequence:
            localize_photo = SequenceFilter(pipeline, speed_px=speed, steps=steps).localize
    for look in pipeline.looks:
        report_failed(look.opened.built)
    output = _Output(
        pipeline, map_file, matches=matches, picture=picture, several=len(photos) > 1, sequence=sequence
    )
    forms, failed, unsure = [], False, False
    for number, photo in enumerate(photos, 1):
        try:
            answer = localize_photo(photo, top=top)
        except PhotoError as error:
            failed = True
            click.echo(f"expmap: {error}", err=True)
            forms.append(failure_to_json(query=str(photo), error=str(error)))
            continue
        forms.append(output.form(photo, answer))
        unsure |= verdict_of(answer) != "place"
        if not as_json:
            output.show(photo, answer, last=number == len(photos))
        try:
            output.draw(photo, answer, number)
        except (PhotoError, MapError) as error:  # satellite image or map photo: the answer is still valid
            failed = True
            click.echo(f"expmap: {error}", err=True)
    if as_json:
        click.echo(json.dumps(forms, indent=2))
    elif unsure and pipeline.method in ("auto", "verified"):
        without_models = settings.retrieval.budget_s > 0.0 and second_look_features(settings.models) is None
        again = pipeline.method == "auto" and chosen["features"] == "auto" and without_models
        click.echo(_LOOK_AGAIN if again else _LOOK_CLOSER, err=True)
    sys.exit(exitcodes.SOME_FAILED if failed else exitcodes.DONE)


def _show_first(answer: Answer) -> None:
    """Show the answer of the first look on a terminal while the second one is taken."""
    if sys.stderr.isatty():
        click.echo(f"first look: {_verdict(answer)}; looking again …", err=True)


def _refuse_unwritable(path: Path | None, option: str) -> None:
    """Fail early if a picture cannot be written to a path."""
    if path is None:
        return
    if path.suffix.lower() not in _FORMATS:
        raise UsageError(f"cannot write a picture to {path.name}", where=option, hint="use .png or .jpg")
    if not path.parent.is_dir():
        raise UsageError(f"folder {path.parent} not found", where=option, hint="create it first")


@dataclass(frozen=True, slots=True)
class _Output:
    """Prints and draws the answers of a run."""

    pipeline: LocalizationPipeline
    cfg: Path
    matches: Path | None
    picture: Path | None
    several: bool
    sequence: bool

    def form(self, photo: Path, answer: Answer) -> dict[str, Any]:
        source = self.pipeline.answer_source(sequence=self.sequence)
        return answer_to_json(answer, query=str(photo), source=source)

    def show(self, photo: Path, answer: Answer, *, last: bool) -> None:
        the_map = self.pipeline.map
        text = answer_text(answer, query=str(photo), georeference=the_map.georeference, floors=the_map.floors)
        click.echo(text)
        if answer.fov is not None and answer.fov.source == "guess":
            click.echo(
                f"the field of view of {photo.name} is not known; {answer.fov.degrees:.0f}° is assumed; "
                "--fov DEGREES gives a better position",
                err=True,
            )
        if not last:
            click.echo()

    def draw(self, photo: Path, answer: Answer, number: int) -> None:
        limits = self.pipeline.settings.photo
        the_map = self.pipeline.map
        if self.picture is not None:
            self._save(map_picture(self.cfg, the_map, answer=answer, limits=limits), self.picture, number)
        if self.matches is not None:
            drawn = match_picture(self.cfg, the_map, query=photo, answer=answer, limits=limits)
            if drawn is None:
                click.echo(f"{photo}: no matches to draw", err=True)
            else:
                self._save(drawn, self.matches, number)

    def _save(self, image: Image.Image, path: Path, number: int) -> None:
        target = path.with_stem(f"{path.stem}-{number}") if self.several else path
        try:
            image.save(target)
        except OSError as error:
            reason = error.strerror or error
            raise StorageError(f"the picture cannot be written: {reason}", where=str(target)) from error
        click.echo(f"drawn: {target}", err=True)
