"""How pycolmap is imported."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, signal, threading
signal.signal(signal.SIGTERM, lambda *_: (print("stopped in order"), os._exit(3)))
from webapp.files.landmarks.colmap import pycolmap
thread = threading.Thread(target=pycolmap)
thread.start()
thread.join()
os.kill(os.getpid(), signal.SIGTERM)
"""


@pytest.mark.skipif(os.name == "nt", reason="no such signals there")
def test_a_worker_that_has_imported_it_still_stops_in_order():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (3, "stopped in order", "")
