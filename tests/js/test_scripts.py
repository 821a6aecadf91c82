"""The unit tests of the pages' scripts, run by node."""

import shutil
import subprocess

import pytest

LONGEST_S = 120


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed: apt install nodejs")
def test_modules(request):
    files = sorted(str(path) for path in request.path.parent.glob("*.test.mjs"))
    assert len(files) >= 5
    answer = subprocess.run(
        ["node", "--test", *files], capture_output=True, text=True, timeout=LONGEST_S, check=False
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
