"""Checks of `make audit` without a network, and its messages then."""

import json
import shutil
import subprocess

from tests.design import audit


def test_vendored_scripts_are_as_they_were_published(project, tmp_path):
    assert list(audit.changed_scripts()) == []
    for script in audit.VENDORED:
        (tmp_path / script.path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(project / script.path, tmp_path / script.path)
    changed = audit.VENDORED[0]
    (tmp_path / changed.path).write_bytes((project / changed.path).read_bytes() + b";alert(1)")
    assert list(audit.changed_scripts(tmp_path)) == [
        f"{changed.path} is not {changed.package} {changed.version} as it was published"
    ]


def test_every_vendored_script_and_style_is_checked(project):
    there = {p.relative_to(project).as_posix() for p in (project / "static" / "vendor").rglob("*.[jc]s*")}
    there |= {p.relative_to(project).as_posix() for p in (project / "tests" / "vendor").rglob("*.js*")}
    assert there == {script.path for script in audit.VENDORED}


def test_licences_go_with_ours(monkeypatch):
    assert list(audit.unusual_licences()) == []
    monkeypatch.setattr(audit, "PERMISSIVE", audit.PERMISSIVE - {"MIT-CMU"})
    assert any(line.startswith("pillow ") and "MIT-CMU" in line for line in audit.unusual_licences())


def answers(stdout, *, code=0, stderr=""):
    return lambda command, *, cwd=None: subprocess.CompletedProcess(command, code, stdout, stderr)


def test_without_the_network_a_line_says_what_was_skipped(monkeypatch):
    monkeypatch.setattr(audit, "_run", answers("", code=1, stderr="npm warn x\nnpm error ENOTFOUND\nmore"))
    (packages,) = audit.vulnerable_packages()
    (scripts,) = audit.vulnerable_scripts()
    assert packages == "SKIPPED: known vulnerabilities of Python packages: npm error ENOTFOUND"
    assert scripts == "SKIPPED: known vulnerabilities of scripts: npm error ENOTFOUND"


def test_what_is_known_is_reported(monkeypatch):
    known = {"id": "PYSEC-1", "fix_versions": ["2.0"]}
    packages = [{"name": "a", "version": "1.0", "vulns": [known]}, {"name": "b", "skip_reason": "not found"}]
    monkeypatch.setattr(audit, "_run", answers(json.dumps({"dependencies": packages})))
    assert list(audit.vulnerable_packages()) == [
        "SKIPPED: known vulnerabilities of 1 of 2 packages: not found",
        "a 1.0 has PYSEC-1, fixed in 2.0",
    ]
    monkeypatch.setattr(
        audit, "_run", answers(json.dumps({"vulnerabilities": {"leaflet": {"severity": "high"}}}))
    )
    assert list(audit.vulnerable_scripts()) == ["leaflet has a vulnerability, high"]


def test_the_bill_of_materials_lists_packages_and_scripts_with_their_licences():
    bill = audit.bill_of_materials()
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    parts = {part["name"]: part for part in bill["components"]}
    assert {"numpy", "flask", "rasterio", "leaflet", "three"} <= parts.keys()
    assert "axe-core" not in parts and "pytest" not in parts, "what tests use is not installed"
    assert all(part["licenses"] and part["purl"].endswith(f"@{part['version']}") for part in parts.values())


def test_a_wheel_that_is_missing_on_a_platform_is_reported(monkeypatch):
    lacking = {"numpy": "aarch64", "poselib": "aarch64"}  # pycolmap has one now

    def pip(command, *, cwd=None):
        name, asked = command[-1].partition("==")[0], " ".join(map(str, command))
        lacks = lacking.get(name, "nowhere") in asked
        return subprocess.CompletedProcess(command, int(lacks), "", "ERROR: No matching distribution found")

    monkeypatch.setattr(audit, "_run", pip)
    assert list(audit.missing_wheels()) == [
        "numpy has no wheel for Linux on arm64",
        "pycolmap has a wheel for Linux on arm64",
    ]
    monkeypatch.setattr(audit, "_run", answers("", code=1, stderr="ERROR: no route to host"))
    assert list(audit.missing_wheels()) == ["SKIPPED: wheels for the container: ERROR: no route to host"]
