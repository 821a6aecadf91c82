"""Known vulnerabilities of dependencies, modified scripts, unusual licences, missing wheels: `make audit`.

Without a network, checks that need it are skipped with a message. The exit code is 1 if something was
found. What an installation with the extra `all` consists of is written to `build/sbom.cdx.json`.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path
from typing import Any, NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
SBOM = ROOT / "build" / "sbom.cdx.json"
_SECONDS = 300.0


class Vendored(NamedTuple):
    """A third-party script, kept here as published."""

    path: str
    package: str
    version: str
    sha256: str


VENDORED = (
    Vendored(
        "static/vendor/leaflet/leaflet.js",
        "leaflet",
        "1.9.4",
        "db49d009c841f5ca34a888c96511ae936fd9f5533e90d8b2c4d57596f4e5641a",
    ),
    Vendored(
        "static/vendor/leaflet/leaflet.css",
        "leaflet",
        "1.9.4",
        "a7837102824184820dfa198d1ebcd109ff6d0ff9a2672a074b9a1b4d147d04c6",
    ),
    Vendored(
        "static/vendor/three/three.module.min.js",
        "three",
        "0.185.0",
        "86bcee248b64f44bcfc23c331ae74619061957d59cab040171dcb6fb5900beb6",
    ),
    Vendored(
        "static/vendor/three/three.core.min.js",
        "three",
        "0.185.0",
        "0e9dd2793e01d0d9eb4f2ab00b4ffcdd4488275ebebee5c31fa8d347bc29f0bf",
    ),
    Vendored(
        "static/vendor/three/OrbitControls.js",
        "three",
        "0.185.0",
        "faabb4e8dfd9235ee4a9fd7c9a3d75f90f1689dbd4944bd6fd32117dacec5f93",
    ),
    Vendored(
        "tests/vendor/axe/axe.min.js.gz",
        "axe-core",
        "4.14.1",
        "29348999450cdf2849a8e70b7912fc2da85a849da39c0d0d5394f51d4a9ed95c",
    ),
)
"""Checksums of the unpacked npm packages."""

SCRIPT_LICENCES = {"leaflet": "BSD-2-Clause", "three": "MIT"}
"""Licences of the vendored scripts that pages load; their files contain or accompany the texts."""

PERMISSIVE = frozenset(
    {
        *("0BSD", "BSD-2-Clause", "BSD-3-Clause", "BSD", "BSD License"),
        *("BSD 3-Clause License", "3-Clause BSD License"),
        *("Apache-2.0", "Apache Software License", "Apache License, Version 2.0"),
        *(
            "MIT",
            "MIT License",
            "MIT-0",
            "MIT-CMU",
            "ISC",
            "Zlib",
            "CC0-1.0",
            "The Unlicense (Unlicense)",
            "any-OSI",
        ),
        *("PSF-2.0", "Python Software Foundation License"),
        *("MPL-2.0", "Mozilla Public License 2.0 (MPL 2.0)"),
    }
)
"""As stated by packages."""

_AND = r" AND | OR | WITH "

FOR_TESTS = PERMISSIVE | {"GNU Library or Lesser General Public License (LGPL)", "LGPL-3.0-only"}
"""Packages that are not part of an installation with the extra `all`."""


PLATFORMS = {
    "amd64": ("manylinux_2_28_x86_64", "manylinux2014_x86_64"),
    "arm64": ("manylinux_2_28_aarch64", "manylinux2014_aarch64"),
}
"""Platforms of the container, as pip names them."""

WITHOUT_WHEEL = {("poselib", "arm64"), ("pycolmap", "arm64")}
"""Known to be missing; `docs/install.md` says what to do."""


def main() -> None:
    """Write the bill of materials, run all checks, print findings and what was skipped."""
    SBOM.parent.mkdir(exist_ok=True)
    SBOM.write_text(json.dumps(bill_of_materials(), indent=1) + "\n", "utf-8")
    found = [
        *changed_scripts(),
        *unusual_licences(),
        *vulnerable_packages(),
        *vulnerable_scripts(),
        *missing_wheels(),
    ]
    problems = [line for line in found if not line.startswith("SKIPPED")]
    sys.stdout.write("\n".join(found or ["nothing was found"]) + "\n")
    raise SystemExit(1 if problems else 0)


def bill_of_materials() -> dict[str, Any]:
    """List packages of an installation with the extra `all`, and vendored scripts, as CycloneDX 1.6."""
    own = distribution("experience-map")
    scripts = {(script.package, script.version) for script in VENDORED if script.path.startswith("static/")}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": _component(own, type="application")},
        "components": [
            *(_component(distribution(name)) for name in sorted(_shipped("experience-map", {"all"}))),
            *(
                {
                    "type": "library",
                    "name": name,
                    "version": version,
                    "purl": f"pkg:npm/{name}@{version}",
                    "licenses": [{"license": {"id": SCRIPT_LICENCES[name]}}],
                }
                for name, version in sorted(scripts)
            ),
        ],
    }


def _component(package: Distribution, *, type: str = "library") -> dict[str, Any]:
    name = canonicalize_name(package.name)
    return {
        "type": type,
        "name": name,
        "version": package.version,
        "purl": f"pkg:pypi/{name}@{package.version}",
        "licenses": [{"license": {"name": licence}} for licence in licences(package)],
    }


def changed_scripts(root: Path = ROOT) -> Iterator[str]:
    """Compare vendored scripts with the published ones."""
    for script in VENDORED:
        data = (root / script.path).read_bytes()
        content = gzip.decompress(data) if script.path.endswith(".gz") else data
        if hashlib.sha256(content).hexdigest() != script.sha256:
            yield f"{script.path} is not {script.package} {script.version} as it was published"


def unusual_licences() -> Iterator[str]:
    """List installed packages whose licence is not one of those compatible with this program's."""
    shipped = _shipped("experience-map", {"all"})
    for package in distributions():
        name = canonicalize_name(package.name)
        allowed = PERMISSIVE if name in shipped else FOR_TESTS
        stated = licences(package)
        if not stated or not allowed.issuperset(stated):
            yield f"{package.name} {package.version} has the licence {', '.join(stated) or 'unknown'}"


def licences(package: Distribution) -> list[str]:
    """Return the licences that a package states."""
    about = package.metadata
    expression = about.get("License-Expression")
    if expression:
        return [part.strip("() ") for part in re.split(_AND, expression)]
    classifiers = about.get_all("Classifier") or []
    named = [c.rpartition(" :: ")[2] for c in classifiers if c.startswith("License :: OSI Approved :: ")]
    first_line = (about.get("License") or "").strip().partition("\n")[0]
    return named or [part.strip() for part in re.split(_AND, first_line) if part]


def _shipped(name: str, extras: set[str]) -> set[str]:
    """Return the packages of an installation with these extras."""
    seen: set[str] = set()
    todo = [(name, extras)]
    while todo:
        name, extras = todo.pop()
        for text in distribution(name).requires or []:
            wanted = Requirement(text)
            needed = wanted.marker is None or any(wanted.marker.evaluate({"extra": e}) for e in extras | {""})
            other = canonicalize_name(wanted.name)
            if needed and (other not in seen or wanted.extras):
                seen.add(other)
                todo.append((other, set(wanted.extras)))
    return seen


def vulnerable_packages() -> Iterator[str]:
    """Check the pinned versions with pip-audit, in a separate environment."""
    environment = ROOT / ".venv" / "audit"
    install = [
        [sys.executable, "-m", "venv", environment],
        [environment / "bin" / "pip", "install", "pip-audit"],
    ]
    pins = ["--no-deps", "--disable-pip", "--requirement", ROOT / "constraints.txt", "--format", "json"]
    for command in install:
        if (failed := _run(command)).returncode:
            yield _skipped("known vulnerabilities of Python packages", failed)
            return
    done = _run([environment / "bin" / "pip-audit", *pins])
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except ValueError:
        yield _skipped("known vulnerabilities of Python packages", done)
        return
    unknown = [package["skip_reason"] for package in packages if "skip_reason" in package]
    if unknown:
        count = f"{len(unknown)} of {len(packages)}"
        yield f"SKIPPED: known vulnerabilities of {count} packages: {unknown[0][:120]}"
    for package in packages:
        for known in package.get("vulns", []):
            fixed = ", ".join(known["fix_versions"]) or "no version yet"
            yield f"{package['name']} {package['version']} has {known['id']}, fixed in {fixed}"


def vulnerable_scripts() -> Iterator[str]:
    """Check vendored scripts, and the tools that check the pages' scripts, with npm."""
    tools = json.loads((ROOT / "tests" / "js" / "package.json").read_text("utf-8"))["devDependencies"]
    wanted = {**tools, **{script.package: script.version for script in VENDORED}}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "package.json").write_text(json.dumps({"private": True, "dependencies": wanted}))
        locked = _run(["npm", "install", "--package-lock-only", "--ignore-scripts"], cwd=folder)
        done = _run(["npm", "audit", "--json"], cwd=folder) if locked.returncode == 0 else locked
    try:
        known = json.loads(done.stdout)["vulnerabilities"]
    except (ValueError, KeyError):
        yield _skipped("known vulnerabilities of scripts", done)
        return
    for name, facts in known.items():
        yield f"{name} has a vulnerability, {facts['severity']}"


def missing_wheels() -> Iterator[str]:
    """Ask pip for a wheel of each package of the container, for each platform, without fetching it."""
    shipped = sorted(_shipped("experience-map", {"all"}))
    wanted = [(name, platform) for name in shipped for platform in PLATFORMS]
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(_ask_for_wheel, *zip(*wanted, strict=True)))
    if all(done.returncode for done in answers):
        yield _skipped("wheels for the container", answers[0])
        return
    for (name, platform), done in zip(wanted, answers, strict=True):
        lacks = done.returncode != 0
        if lacks != ((name, platform) in WITHOUT_WHEEL):
            yield f"{name} has {'no' if lacks else 'a'} wheel for Linux on {platform}"


def _ask_for_wheel(name: str, platform: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--no-deps"]
    command += ["--ignore-installed", "--only-binary=:all:", "--python-version", "3.12"]
    command += [word for tag in PLATFORMS[platform] for word in ("--platform", tag)]
    with tempfile.TemporaryDirectory() as folder:
        return _run([*command, "--target", folder, f"{name}=={distribution(name).version}"])


def _skipped(what: str, failed: subprocess.CompletedProcess[str]) -> str:
    lines = (failed.stderr or failed.stdout).strip().splitlines() or [f"exit code {failed.returncode}"]
    named = [line for line in lines if "error" in line.lower()] or lines[-1:]
    return f"SKIPPED: {what}: {named[0][:200]}"


def _run(command: list[str | Path], *, cwd: str | None = None) -> subprocess.CompletedProcess[str]:
    words = [str(word) for word in command]
    # the project's pins do not apply to pip-audit itself
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    try:
        return subprocess.run(
            words, cwd=cwd, env=environment, capture_output=True, text=True, timeout=_SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(words, 1, "", str(error))


if __name__ == "__main__":
    main()
