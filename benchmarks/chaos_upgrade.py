"""Updates a cluster from an older version to this one, machine by machine, under the load of `chaos`.

    python -m benchmarks.chaos --upgrade-from COMMIT [--nodes 3] [--minutes 4] [--longest 5] [--s3]

Web nodes and a job worker run from a worktree of COMMIT, and so does what makes the library. The steps are
those of "Updating without a pause" in `docs/cluster-running.md`: first the worker, which migrates the tables,
then one node after the other. Before that, one node is killed with SIGKILL and started again with the old
code, as systemd would, so that an old node also starts with the new tables.

Prints tables: what was acknowledged, lost and stored twice; the longest time in which a client got no
answer, although it repeats its request on the other nodes; errors of old nodes after the migration.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from benchmarks.chaos_checks import check_load, figures, longest_refusal
from benchmarks.chaos_cluster import Balancer, Program, WebNode, start_stores
from benchmarks.chaos_library import Made
from benchmarks.chaos_site import Site, people, set_up
from tests.cluster.dask_cluster import ROOT
from tests.ports import reserved_port
from webapp.files.contents import connect
from webapp.settings import Settings

_SETTLES_S = 5.0
"""Time before the first step, and between two nodes."""
_MIGRATES_WITHIN_S = 120.0
_MIGRATED = re.compile(r"migrated from (\d+) to (\d+) in ([\d.]+) s")
_PROBES = ("/healthz", "/readyz", "/livez")
"""Routes that answer 503 while a node is about to stop."""


@dataclass(frozen=True)
class Migration:
    """When the tables had been migrated, in words what was done, and in which time."""

    at: datetime
    versions: str
    seconds: float


@dataclass(frozen=True)
class Update:
    """The update of all machines; `begin` is by the monotonic clock, `seconds` its whole time."""

    migration: Migration
    begin: float
    seconds: float


def main(arguments: argparse.Namespace) -> int:
    """Run the load during the update and print tables; return the exit code."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        old = stack.enter_context(worktree(arguments.upgrade_from, folder / "old"))
        stores = start_stores(stack, s3=arguments.s3)
        environ = {**stores.environ, "EXPMAP_SERVE_JOB_WORKERS": "0", "EXPMAP_SERVE_DRAIN_S": "2"}
        ports = [stack.enter_context(reserved_port()) for _ in range(arguments.nodes)]
        address = stack.enter_context(Balancer(ports)).url
        site = Site(address, folder / "maps", stores.url, stores.storage)
        made = _make_library(old, site, arguments)
        nodes = [WebNode(site.folder, port, environ=environ, log=folder / f"{port}-old") for port in ports]
        words = ["worker", "--library", str(site.folder), "--log", "json"]
        worker = Program(words, environ=environ, log=folder / "worker-old")
        for program in (worker, *nodes):
            program.code = old
            program.start()
            stack.callback(program.end)
        for node in nodes:
            node.wait()
        load, first = set_up(site, arguments, made=made)
        with ThreadPoolExecutor(1) as pool:
            updating = pool.submit(_update, worker, nodes, folder)
            load.work(arguments)
            in_time = updating.done()
            update = updating.result()
        library = site.library()
        connect(Settings(database=site.database, storage=site.storage, cache_folder=folder / "cache"))
        findings = check_load(load, site, library, first=first)
        library.database.close()
        errors = old_errors(folder.glob("*-old"), since=update.migration.at)
    longest = longest_refusal(load.refusals, [])
    problems = [*findings.problems, *errors]
    problems += [] if in_time else ["the load ended before the update: use more --minutes"]
    if longest["s"] > arguments.longest:
        problems.append(f"a client got no answer for {longest['s']} s: {longest['request']}")
    print(as_tables(figures(load, findings), longest=longest, errors=errors, update=update))
    for since, until, what in load.refusals.times:
        print(
            f"{since - update.begin:5.1f} s: {until - since:.1f} s without an answer: {what}", file=sys.stderr
        )
    print("\n".join(problems[:50]), file=sys.stderr)
    return 1 if problems else 0


@contextmanager
def worktree(commit: str, folder: Path) -> Iterator[Path]:
    """Check a commit out into a folder for the time of the block."""
    subprocess.run(
        ["git", "worktree", "add", "--quiet", "--detach", str(folder), commit], cwd=ROOT, check=True
    )
    try:
        yield folder
    finally:
        subprocess.run(["git", "worktree", "remove", "--force", str(folder)], cwd=ROOT, check=True)


def _make_library(code: Path, site: Site, arguments: argparse.Namespace) -> Made:
    """Make the library with the code of a checkout."""
    script = str(ROOT / "benchmarks" / "chaos_library.py")
    words = [str(site.folder), site.database, str(arguments.robots), str(people(arguments))]
    done = subprocess.run(
        [sys.executable, "-P", script, *words],
        cwd=code, env={**os.environ, "PYTHONPATH": str(code)}, check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    return Made(**json.loads(done.stdout))


def _update(worker: Program, nodes: Sequence[WebNode], folder: Path) -> Update:
    """Update the worker, kill a node and restart it as it was, and update the nodes one by one."""
    time.sleep(_SETTLES_S)
    begin = time.monotonic()

    def done(what: str) -> None:
        print(f"{time.monotonic() - begin:5.1f} s: {what}", file=sys.stderr, flush=True)

    _change_code(worker, folder / "worker-new")
    migration = _wait_for_migration(worker.log)
    done("tables migrated by the new worker")
    nodes[-1].kill()
    time.sleep(1.0)
    nodes[-1].start()
    nodes[-1].wait()
    done(f"{nodes[-1].port} killed, answers again with the old code")
    for node in nodes:
        _change_code(node, folder / f"{node.port}-new")
        done(f"{node.port} stopped")
        node.wait()
        done(f"{node.port} answers with the new code")
        time.sleep(_SETTLES_S)
    return Update(migration, begin, time.monotonic() - begin)


def _change_code(program: Program, log: Path) -> None:
    program.end()
    program.code, program.log = ROOT, log
    program.start()


def _wait_for_migration(log: Path) -> Migration:
    until = time.monotonic() + _MIGRATES_WITHIN_S
    while time.monotonic() < until:
        for line in read_log(log):
            if found := _MIGRATED.search(line["message"]):
                return Migration(_time(line), f"{found[1]} to {found[2]}", float(found[3]))
        time.sleep(0.1)
    raise SystemExit(f"the tables were not migrated:\n{log.read_text()}")


def read_log(log: Path) -> list[dict[str, Any]]:
    """Read the complete lines of a log in JSON; others are left out."""
    lines = []
    for line in log.read_text("utf-8").splitlines():
        try:
            lines.append(json.loads(line))
        except ValueError:
            continue  # a library has written it, or it is not complete yet
    return [line for line in lines if isinstance(line, dict)]


def _time(line: dict[str, Any]) -> datetime:
    return datetime.fromisoformat(line["time"])


def old_errors(logs: Iterable[Path], *, since: datetime) -> list[str]:
    """List the errors in the logs of old programs from a time on; refusals of a node that stops are none."""
    return [
        f"an old program: {line['message']} {line.get('traceback', '')[-300:]}"
        for log in logs
        for line in read_log(log)
        if _time(line) >= since and line.get("route") not in _PROBES
        if line["level"] in ("error", "critical") or line.get("status", 0) >= 500
    ]


def as_tables(counts: dict[str, Any], *, longest: dict[str, Any], errors: list[str], update: Update) -> str:
    """Write the result as two tables in Markdown."""
    kinds = {name: count for name, count in counts.items() if isinstance(count, dict)}
    rows = [f"| {name} | {n['acknowledged']} | {n['lost']} | {n['double']} |" for name, n in kinds.items()]
    others = {
        "answers to photos": counts["answers"],
        "longest time without an answer": f"{longest['s']} s",
        "times that a client had to repeat a request": longest["refusals"],
        "errors of old programs after the migration": len(errors),
        f"migration from {update.migration.versions}": f"{update.migration.seconds} s",
        "update of all machines": f"{update.seconds:.0f} s",
    }
    return "\n".join(
        [
            "| what | acknowledged | lost | stored twice |",
            "|---|---|---|---|",
            *rows,
            "",
            "| | |",
            "|---|---|",
        ]
        + [f"| {name} | {value} |" for name, value in others.items()]
    )
