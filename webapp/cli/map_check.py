"""`expmap map check`: what is wrong with a map and how to fix it."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import click

from webapp.cli.exitcodes import BAD_MAP
from webapp.configuration import load_settings
from webapp.core.mapmodel.findings import Finding
from webapp.progress import Progress
from webapp.tasks.maps import check_map

_SHOWN = {"error": 20, "warning": 5}
"""Findings of one kind in one file that are printed; --json has all."""


@click.command("check")
@click.argument("cfg", metavar="MAP.cfg", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print all findings as one JSON object.")
@click.pass_context
def check(ctx: click.Context, cfg: Path, as_json: bool) -> None:
    """Say what is wrong with a map file and how to fix it.

    Looks at the .cfg, the map.json and placements beside it, the satellite image and every photo.
    Exit code 3 when the map has errors; warnings alone leave it usable.
    """
    report = check_map.check_map(cfg, settings=load_settings(), progress=Progress())
    if as_json:
        click.echo(json.dumps(_as_json(report), indent=1))
    else:
        _print(report)
    counts = ((report.photos, "photo"), (report.errors, "error"), (report.warnings, "warning"))
    summary = ", ".join(f"{count} {noun}{'s' * (count != 1)}" for count, noun in counts)
    click.echo(f"{cfg}: {summary}", err=True)
    if report.errors:
        ctx.exit(BAD_MAP)


def _print(report: check_map.Report) -> None:
    """Print the findings; of one kind in one file, only the first."""
    seen: Counter[tuple[str, str]] = Counter()
    most: dict[tuple[str, str], int] = {}
    for finding in report.findings:
        kind = (finding.file, finding.code)
        seen[kind] += 1
        most[kind] = _SHOWN[finding.severity]
        if seen[kind] <= most[kind]:
            place = f"{_file(report, finding)}:{finding.line}:{finding.column}"
            click.echo(
                f"{place}: {finding.severity}: {finding.message} ({finding.code})\n    fix: {finding.fix}"
            )
    for (file, code), count in seen.items():
        if count > most[file, code]:
            name = report.cfg_path.with_name(file) if file else report.cfg_path
            click.echo(f"{name}: {count - most[file, code]} more of {code}; --json lists all", err=True)


def _file(report: check_map.Report, finding: Finding) -> Path:
    return report.cfg_path.with_name(finding.file) if finding.file else report.cfg_path


def _as_json(report: check_map.Report) -> dict[str, object]:
    findings = [
        {
            "file": str(_file(report, finding)),
            "line": finding.line,
            "column": finding.column,
            "severity": finding.severity,
            "code": str(finding.code),
            "message": finding.message,
            "fix": finding.fix,
        }
        for finding in report.findings
    ]
    return {
        "photos": report.photos,
        "errors": report.errors,
        "warnings": report.warnings,
        "findings": findings,
    }
