"""What a build has to tell, as text for the terminal."""

from __future__ import annotations

import click

from webapp.tasks.localize.build_index import BuildReport


def tell_failed(report: BuildReport | None) -> None:
    """Name the map photos that could not be used, on standard error; nothing where nothing was built."""
    for number, photo, reason in report.failed if report else ():
        click.echo(f"{photo} (id {number}): {reason}", err=True)


def build_line(report: BuildReport, features: str) -> str:
    """Sum up a build in a line."""
    return (
        f"{report.folder}: {report.photos} photos with {features}, {report.extracted} computed, "
        f"{report.reused} kept, {report.removed} removed, {len(report.failed)} failed; "
        f"{report.descriptors} descriptors, {report.bytes / 1e6:.1f} MB, {report.seconds:.1f} s"
    )
