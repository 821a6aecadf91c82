"""`expmap map street-photos`: add street-level photos from a service to a map."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.options import MAP_FILE, area_option
from webapp.cli.progressbar import terminal_progress
from webapp.core.geo.tilegrid import GeoBox
from webapp.errors import UsageError
from webapp.settings import StreetSettings
from webapp.tasks.landmarks.accept import library_of
from webapp.tasks.street.add_street import StreetReport, add_street_photos
from webapp.tasks.street.survey import (
    PANORAMA_WISHES,
    SOURCES,
    FolderTarget,
    LibraryTarget,
    PanoramaWish,
    PixelBox,
    SourceKey,
    StreetRequest,
    StreetSurvey,
    StreetTarget,
    services,
    survey_json,
    survey_street,
)


@click.command("street-photos", short_help="Add street-level photos from Panoramax or Mapillary.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option("--source", type=click.Choice(SOURCES), help="The service; default: the first that is set up.")
@area_option(
    "--bbox", sides="WEST,SOUTH,EAST,NORTH", text="The area, degrees; default: all of the map's image."
)
@area_option("--within", sides="LEFT,TOP,RIGHT,BOTTOM", text="The area, in pixels of the map's image.")
@click.option(
    "--panoramas", type=click.Choice(PANORAMA_WISHES), default="cut", show_default=True,
    help="Cut each into six level views, skip them, or keep them as they are.",
)  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Show what there is, but download nothing.")
@click.option("--yes", is_flag=True, help="Download without asking.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def street_photos(
    ctx: click.Context,
    cfg: Path,
    source: SourceKey | None,
    bbox: tuple[float, ...] | None,
    within: tuple[float, ...] | None,
    panoramas: PanoramaWish,
    dry_run: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Add the photos that a street-level service has of an area, with places, headings, authors and licences.

    Their number and approximate size are printed first. The map needs a georeference. It can be stopped at
    any time: the next run continues, and photos that the map already has are never fetched again. Exit code 1
    when a photo could not be used.
    """
    if bbox is not None and within is not None:
        raise click.UsageError("give either --bbox or --within")
    settings = settings_in_use(cfg)
    with library_of(cfg, settings=settings) as there:
        target: StreetTarget = (
            FolderTarget(cfg, settings=settings)
            if there is None
            else LibraryTarget(there[0], there[1], settings=settings)
        )
        area = _area(bbox, within)
        request = StreetRequest(source or _first(settings.street), area, panoramas)
        with terminal_progress("photos") as progress:
            survey = survey_street(target, request, settings=settings.street, progress=progress)
        _say(survey)
        report = StreetReport(0, 0)
        goes_on = bool(survey.wanted) and not dry_run
        if goes_on and not yes and sys.stdin.isatty():
            goes_on = click.confirm("Download them?", default=True, err=True)
        if goes_on:
            with terminal_progress("photos") as progress:
                report = add_street_photos(
                    target, survey, request=request, settings=settings, progress=progress
                )
    click.echo(json.dumps(_as_json(survey, report), indent=1) if as_json else _lines(survey, report))
    if report.failed:
        ctx.exit(SOME_FAILED)


def _area(bbox: tuple[float, ...] | None, within: tuple[float, ...] | None) -> GeoBox | PixelBox | None:
    if bbox is not None:
        west, south, east, north = bbox
        return GeoBox(north, south, west, east)
    return None if within is None else PixelBox(*within)


def _first(settings: StreetSettings) -> SourceKey:
    for source in services(settings):
        return source
    raise UsageError(
        "no street-level service is set up",
        hint="set street.panoramax or street.mapillary_token, see docs/street.md",
    )


def _say(survey: StreetSurvey) -> None:
    """Print a summary of the download to standard error."""
    megabytes = survey.size_bytes / 1e6
    licences = ", ".join(f"{licence}: {count}" for licence, count in survey.licences.items())
    parts = [f"{survey.service}: {len(survey.wanted)} photos to download, about {megabytes:.1f} MB"]
    parts += [f"licences {licences}"] if licences else []
    parts += [
        f"{count} {words}"
        for count, words in (
            (survey.panoramas, "of them panoramas"),
            (survey.known, "in the map already"),
            (survey.outside, "outside its image"),
            (survey.skipped, "panoramas left out"),
            (survey.unusable, "cannot be used"),
        )
        if count
    ]
    click.echo("; ".join(parts), err=True)


def _lines(survey: StreetSurvey, report: StreetReport) -> str:
    lines = [f"{one.id}  {one.reason}" for one in report.failed]
    return "\n".join([*lines, f"{report.added} photos added, {len(report.failed)} failed"])


def _as_json(survey: StreetSurvey, report: StreetReport) -> dict[str, object]:
    return {
        **survey_json(survey),
        "added": report.added,
        "duplicates": report.duplicates,
        "failed": [asdict(one) for one in report.failed],
    }
