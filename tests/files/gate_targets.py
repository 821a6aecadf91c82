"""Functions that tests have called in a child process behind the gate."""

import os
import pathlib
import sys
import time

from webapp.errors import TrackError, UsageError
from webapp.files import gate
from webapp.files.gate import Budget


def count(n):
    for number in range(n):
        yield str(number).encode()


def spin():
    """Send the id of the process, and then keep the interpreter busy in one call that never returns."""
    yield str(os.getpid()).encode()
    sum(iter(int, 1))


def loop():
    yield b"begun"
    while True:
        pass


def wait():
    yield str(os.getpid()).encode()
    time.sleep(1000)


def fill(size):
    yield str(len(bytearray(size))).encode()


def complain(kind):
    yield b"begun"
    if kind == "track":
        raise TrackError("it is damaged", where="line 3", hint="mend it")
    if kind == "usage":
        raise UsageError("no such option")
    raise KeyError("a bug")


def crash():
    yield b"begun"
    os.abort()


def huge():
    yield bytes(gate.MAX_MESSAGE + 1)


def write(path):
    with pathlib.Path(path).open("wb") as file:
        file.write(b"x")
    yield b"written"


if __name__ == "__main__":  # a caller that will be killed
    for message in gate.run("tests.files.gate_targets:spin", {}, budget=Budget(100, 100, 100)):
        os.write(1, message + b"\n")
        sys.stdin.readline()
