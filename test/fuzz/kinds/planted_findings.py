"""Inputs with forbidden side effects, for the tests of their detection; not part of campaigns."""

import os
import socket
import subprocess
import sys
import tempfile
from itertools import repeat
from typing import Any

from retalis import UsageError

from .base import Kind


def documented() -> None:
    raise UsageError("wrong")


def undocumented() -> None:
    raise KeyError("wrong")


def swallowed() -> None:
    try:
        os.system("true")
    except Exception:  # a forbidden act is a finding even if its error is caught
        return


def recursion() -> Any:
    return recursion()


def loop() -> None:
    while True:
        try:
            len("")
        except Exception:  # no handler of errors holds it up
            continue


def grow() -> None:
    blocks = [bytes(1 << 20) + b"x" for _ in range(200)]
    del blocks[:]


def endless() -> int:
    return sum(repeat(0))


ACTS = {
    "documented": documented,
    "undocumented": undocumented,
    "swallowed": swallowed,
    "recursion": recursion,
    "loop": loop,
    "grow": grow,
    "endless": endless,
    "crash": os.abort,
    "read": lambda: os.open("/etc/passwd", os.O_RDONLY),
    "write": lambda: os.open("written", os.O_WRONLY | os.O_CREAT),
    "scratch": lambda: os.open("progress", os.O_RDONLY),
    "listing": lambda: os.listdir("/"),
    "removal": lambda: os.remove("progress"),
    "folder": lambda: os.mkdir("made"),
    "temporary": tempfile.mkstemp,
    "process": lambda: subprocess.Popen(["true"]),
    "fork": os.fork,
    "replaced": lambda: os.execv("/bin/true", ["true"]),
    "connection": lambda: socket.socket(),
    "source": lambda: eval("1 + 1"),
    "code": lambda: exec(compile("x = 1", "<x>", "exec")),
    "module": lambda: __import__("colorsys"),
    "trace": lambda: sys.settrace(None),
}


class Inputs(Kind):
    may_warm_up = False

    def setup(self) -> None:
        self.corpus = [act.encode() for act in ACTS]

    def generate(self, rng: Any) -> bytes:
        return b"documented"

    def run(self, data: Any) -> None:
        self.attempt(ACTS[data.decode()])
