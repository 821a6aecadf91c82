"""Kills parts of a cluster at random under load, and checks that nothing is lost, duplicated or damaged.

    python -m benchmarks.chaos [--minutes 20] [--editors 20] [--robots 20] [--uploaders 2] [--every 10] [--s3]
                               [--upgrade-from COMMIT]

Starts PostgreSQL, a scheduler with two workers of Dask, and two web nodes with a worker each, all on this
machine, with a temporary library. Every few seconds one of these is killed with SIGKILL and restarted: a web
node with all its processes, one of its processes, a worker, a worker of Dask, or PostgreSQL (SIGQUIT, like a
power cut). Meanwhile people edit maps, robots send poses, and photos are uploaded, placed and built into
indexes by jobs on Dask. With --s3 photos and indexes are in S3, each node has its own cache, and the S3
server stops responding now and then.

Prints a JSON object. Checks: each acknowledged edit is in the database unless a later one changed the same
photo; no revision was given twice; all edits are in `map.cfg`; each pose is stored once, in order; each
acknowledged photo is stored once, undamaged, at its acknowledged position; no job has failed, and photos that
clients localize are found. The longest refusal is the longest time in which a client got no answer, except
while PostgreSQL was down. The exit code is 1 if a check fails, or if a refusal was longer than `--longest`.

With --upgrade-from nothing is killed at random: the nodes run an older version at first and are updated to
this one, see `benchmarks/chaos_upgrade.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

from benchmarks import chaos_upgrade
from benchmarks.chaos_checks import check_load, figures, jobs, longest_refusal
from benchmarks.chaos_cluster import Balancer, Chaos, Cluster, WebNode, start_stores, tail
from benchmarks.chaos_library import make_library
from benchmarks.chaos_site import Site, people, set_up
from tests.cluster.dask_cluster import DaskCluster
from tests.ports import reserved_port
from webapp.files.contents import connect
from webapp.settings import Settings

_NODES = 2
_DASK_WORKERS = 2


def main() -> None:
    """Run the load and print the result."""
    arguments = _arguments()
    raise SystemExit(
        _kill_parts(arguments) if arguments.upgrade_from is None else chaos_upgrade.main(arguments)
    )


def _kill_parts(arguments: argparse.Namespace) -> int:
    """Run the load while parts are killed, and print one JSON object; return the exit code."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        stores = start_stores(stack, s3=arguments.s3)
        dask = DaskCluster(_made(folder / "dask"), workers=_DASK_WORKERS)
        stack.callback(dask.stop)
        environ = {**stores.environ, "EXPMAP_DASK": dask.address}
        ports = [stack.enter_context(reserved_port()) for _ in range(_NODES)]
        nodes = [
            WebNode(
                folder / "maps",
                port,
                environ={**environ, "EXPMAP_CACHE_FOLDER": str(folder / f"cache-{port}")},
                log=folder / "log",
            )
            for port in ports
        ]
        cluster = Cluster(stores.database, dask, nodes, stores.objects)
        address = stack.enter_context(Balancer(ports)).url
        site = Site(address, folder / "maps", stores.url, stores.storage)
        made = make_library(site.folder, site.database, robots=arguments.robots, people=people(arguments))
        cluster.start()
        stack.callback(cluster.end)
        load, first = set_up(site, arguments, made=made)
        with Chaos(cluster, every_s=arguments.every, seed=arguments.seed) as chaos:
            load.work(arguments)
        library = site.library()
        connect(Settings(database=site.database, storage=site.storage, cache_folder=folder / "cache"))
        findings = check_load(load, site, library, first=first)
        problems = [*chaos.problems, *findings.problems]
        done = Counter(f"{kind} {state}" for kind, state in jobs(library))
        library.database.close()
        longest = longest_refusal(load.refusals, cluster.outages)
        if longest["s"] > arguments.longest:
            problems.append(f"a client got no answer for {longest['s']} s: {longest['request']}")
        if problems:
            print(tail(folder / "log"))
    print(
        json.dumps(
            {
                "minutes": arguments.minutes,
                **figures(load, findings),
                "load": round(os.getloadavg()[0], 1),
                "jobs": dict(done),
                "killed": dict(chaos.killed),
                "longest_refusal": longest,
                "problems": problems[:50],
            },
            indent=2,
        )
    )
    return 1 if problems else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--editors", type=int, default=20)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--uploaders", type=int, default=2)
    parser.add_argument("--localizing", type=int, default=10, help="clients that localize photos")
    parser.add_argument("--every", type=float, default=10, help="mean seconds between two kills")
    parser.add_argument("--pause", type=float, default=2.0, help="mean seconds between two edits of a client")
    parser.add_argument(
        "--longest", type=float, default=10, help="seconds without an answer that are allowed"
    )
    parser.add_argument("--s3", action="store_true", help="photos and indexes are in S3")
    parser.add_argument("--upgrade-from", metavar="COMMIT", help="update the nodes from this commit instead")
    parser.add_argument("--nodes", type=int, default=3, help="with --upgrade-from")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


if __name__ == "__main__":
    main()
