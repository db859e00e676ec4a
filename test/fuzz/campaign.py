"""Campaigns: many inputs of a kind in worker processes, and their findings."""

import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, List

from python_path import python_path

from .known_findings import reason

HERE = Path(__file__).resolve().parent
MAX_INPUT_CPU_SECONDS = 10.0
"""CPU seconds of one input after which its process is killed, because no handler could end it."""

MAX_INPUT_SECONDS = 60.0
"""Seconds of one input after which its process is killed."""

POLL_INTERVAL_SECONDS = 0.5
"""Seconds between two checks of a process."""

MAX_DEATHS = 30
"""Number of processes that may die before a campaign ends."""

FOLDER = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Folder of inputs that must be files: in memory if possible."""

_TICKS = os.sysconf("SC_CLK_TCK")


class Campaign:
    """Run over inputs of one kind.

    Attributes:
        findings: the first input of each finding with the number of its inputs, by key.
        done: number of processed inputs.
        accepted_count: number of steps without an error.
        refused_count: number of steps with a documented error.
        slowest: seconds of CPU time of the slowest input.
    """

    def __init__(self, kind: Any, seed: int = 1) -> None:
        self.kind = kind
        self.seed = seed
        self.findings = {}
        self.done = self.accepted_count = self.refused_count = self.deaths = self.peak = 0
        self.slowest = 0.0
        self._lock = threading.Lock()

    def run(self, inputs: Any, jobs: int = 1, minutes: float = 0.0, first: int = 0) -> None:
        """Process inputs from a number on, with several processes at a time."""
        end = time.monotonic() + 60 * minutes if minutes else None
        share = -(-inputs // jobs)
        parts = [
            threading.Thread(
                target=self._part, args=(first + at * share, min(share, inputs - at * share), end)
            )
            for at in range(jobs)
        ]
        for part in parts:
            part.start()
        for part in parts:
            part.join()
        self._confirm()

    def replay(self, first: Any, number: Any) -> None:
        """Process the inputs of a block up to a number."""
        self._part(first, number - first + 1, None)

    def file(self, path: Any) -> None:
        """Process an input in a file."""
        with tempfile.TemporaryDirectory(prefix="fuzz", dir=FOLDER) as scratch:
            _Process(self, scratch, ["file", str(Path(path).resolve())]).wait()

    def found(self, line: Any) -> None:
        """Add a finding."""
        with self._lock:
            known = self.findings.setdefault(line["key"], dict(line, times=0))
            known["times"] += 1

    def add(self, figures: Any) -> None:
        """Add the counts of a process that has ended."""
        with self._lock:
            self.accepted_count += figures["taken"]
            self.refused_count += figures["refused"]
            self.slowest = max(self.slowest, figures["slowest"])
            self.peak = max(self.peak, figures["peak"])

    def _part(self, first: Any, count: Any, end: Any) -> None:
        stop = first + count
        while first < stop:
            seconds = 0.0 if end is None else max(0.1, end - time.monotonic())
            with tempfile.TemporaryDirectory(prefix="fuzz", dir=FOLDER) as scratch:
                process = _Process(self, scratch, [str(first), str(stop - first), str(seconds)])
                died_at = process.wait()
            with self._lock:
                self.done += process.done if died_at is None else max(0, died_at - first + 1)
                self.deaths += died_at is not None
            if died_at is None or self.deaths > MAX_DEATHS or (end is not None and time.monotonic() > end):
                return
            first = max(first, died_at) + 1

    def _confirm(self) -> None:
        """Mark findings of time and memory that do not recur: another process may have slowed down the machine."""
        for line in list(self.findings.values()):
            if line["what"] in ("time", "growth") and not known_reason(line):
                again = Campaign(self.kind, self.seed)
                again.replay(line["since"], line["number"])
                if not any(one["what"] == line["what"] for one in again.findings.values()):
                    line["what"] = "once"

    @property
    def counted(self) -> List[Any]:
        """The findings that count."""
        return [line for line in self.findings.values() if line["what"] != "once" and not known_reason(line)]

    @property
    def known(self) -> List[Any]:
        """The findings whose repair is planned."""
        return [line for line in self.findings.values() if known_reason(line)]


def known_reason(line: Any) -> Any:
    """Return the reason why a finding is known, or ""."""
    return reason(line["kind"], line["what"], f"{line['where']} {line['detail']}")


class _Process:
    """A process that works on inputs, and what it tells."""

    def __init__(self, campaign: Any, scratch: Any, what: Any) -> None:
        self._campaign = campaign
        self._scratch = Path(scratch)
        (self._scratch / "progress").write_bytes(struct.pack("<qq", -1, 0))
        inputs = self._scratch / "inputs"
        inputs.mkdir()
        self._errors = (self._scratch / "errors").open("w+b")
        command = [sys.executable, "-m", "fuzz.worker", campaign.kind, str(campaign.seed), str(inputs), *what]
        (inputs / "progress").write_bytes(struct.pack("<qq", -1, 0))
        self._progress = inputs / "progress"
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=dict(os.environ, PYTHONPATH=python_path(HERE.parent), PYTHONHASHSEED="0"),
        )
        self.done = 0
        self._ended = False
        self._killed = ""

    def wait(self) -> Any:
        """Read its output until it ends; return the number of the input that has killed it, or None."""
        guard = threading.Thread(target=self._guard, daemon=True)
        guard.start()
        for text in self._process.stdout:
            line = json.loads(text)
            if "done" in line:
                self.done = line["done"]
                self._ended = True
                self._campaign.add(line)
            else:
                self._campaign.found(line)
        status = self._process.wait()
        guard.join()
        self._errors.seek(0)
        errors = self._errors.read().decode(errors="replace")
        self._errors.close()
        if self._ended:
            return None
        number, since = self._at()
        if number < 0:
            raise RuntimeError(f"a process of kind {self._campaign.kind} did not start: {errors}")
        what = self._killed or f"died ({status})"
        places = [line.strip() for line in errors.splitlines() if "retalis/" in line]
        where = self._subject() or (places[0].split("retalis/")[-1] if places else "somewhere")
        self._campaign.found(
            {
                "key": f"{what} {where}",
                "what": what,
                "detail": errors[-1500:],
                "where": where,
                "kind": self._campaign.kind,
                "seed": self._campaign.seed,
                "number": number,
                "since": since,
                "again": False,
            }
        )
        return number

    def _at(self) -> Any:
        return struct.unpack("<qq", self._progress.read_bytes()[:16])

    def _subject(self) -> str:
        return self._progress.read_bytes()[16:].rstrip(b"\0").decode(errors="replace")

    def _guard(self) -> None:
        """End a process that stays at one input."""
        last, since, used = None, time.monotonic(), 0.0
        while True:
            try:
                self._process.wait(POLL_INTERVAL_SECONDS)
                return
            except subprocess.TimeoutExpired:
                pass
            at, now, cpu = self._at(), time.monotonic(), self._cpu()
            if at != last or at[0] < 0:
                last, since, used = at, now, cpu
            elif cpu - used > MAX_INPUT_CPU_SECONDS or now - since > MAX_INPUT_SECONDS:
                self._killed = "hang" if cpu - used > MAX_INPUT_CPU_SECONDS else "blocked"
                self._process.send_signal(signal.SIGABRT)  # faulthandler tells where it is
                return

    def _cpu(self) -> Any:
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            return 0.0
        return (int(fields[11]) + int(fields[12])) / _TICKS
