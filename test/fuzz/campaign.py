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
from typing import Any, Dict, List

from asserting_accessors import required
from subprocess_python_path import python_path

from .known_findings import reason

HERE = Path(__file__).resolve().parent
MAX_INPUT_CPU_SECONDS = 10.0
"""Maximum CPU time of an input in seconds; its process is killed afterwards."""

MAX_INPUT_SECONDS = 60.0
"""Maximum duration of an input in seconds; its process is killed afterwards."""

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
        self.findings: Dict[Any, Any] = {}
        self.done = self.accepted_count = self.refused_count = self.deaths = self.peak = 0
        self.slowest = 0.0
        self._lock = threading.Lock()

    def run(self, inputs: Any, jobs: int = 1, minutes: float = 0.0, first: int = 0) -> None:
        """Process inputs from a number on, with several processes at a time."""
        end = time.monotonic() + 60 * minutes if minutes else None
        share = -(-inputs // jobs)
        threads = [
            threading.Thread(
                target=self._process_part,
                args=(first + part_number * share, min(share, inputs - part_number * share), end),
            )
            for part_number in range(jobs)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self._confirm()

    def replay(self, first: Any, number: Any) -> None:
        """Process the inputs of a block up to a number."""
        self._process_part(first, number - first + 1, None)

    def file(self, path: Any) -> None:
        """Process an input in a file."""
        with tempfile.TemporaryDirectory(prefix="fuzz", dir=FOLDER) as scratch:
            _Process(self, scratch, ["file", str(Path(path).resolve())]).wait()

    def add_finding(self, line: Any) -> None:
        """Add a finding, or count it."""
        with self._lock:
            finding = self.findings.setdefault(line["key"], dict(line, times=0))
            finding["times"] += 1

    def add_counts(self, counts: Any) -> None:
        """Add the counts of a process that has ended."""
        with self._lock:
            self.accepted_count += counts["accepted"]
            self.refused_count += counts["refused"]
            self.slowest = max(self.slowest, counts["slowest"])
            self.peak = max(self.peak, counts["peak"])

    def _process_part(self, first: Any, count: Any, end: Any) -> None:
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
            if line["category"] in ("time", "growth") and not known_reason(line):
                repetition = Campaign(self.kind, self.seed)
                repetition.replay(line["since"], line["number"])
                if not any(
                    finding["category"] == line["category"] for finding in repetition.findings.values()
                ):
                    line["category"] = "once"

    @property
    def counted(self) -> List[Any]:
        """Findings that fail a test."""
        return [
            line for line in self.findings.values() if line["category"] != "once" and not known_reason(line)
        ]

    @property
    def known(self) -> List[Any]:
        """The findings whose repair is planned."""
        return [line for line in self.findings.values() if known_reason(line)]


def known_reason(line: Any) -> Any:
    """Return the reason why a finding is known, or ""."""
    return reason(line["kind"], line["category"], f"{line['place']} {line['detail']}")


class _Process:
    """A worker process with its findings.

    Args:
        campaign: the campaign that gets the findings.
        scratch: a folder of the process's own.
        arguments: command-line arguments that select the inputs.
    """

    def __init__(self, campaign: Any, scratch: Any, arguments: Any) -> None:
        self._campaign = campaign
        self._scratch = Path(scratch)
        (self._scratch / "progress").write_bytes(struct.pack("<qq", -1, 0))
        folder = self._scratch / "inputs"
        folder.mkdir()
        self._errors = (self._scratch / "errors").open("w+b")
        command = [
            sys.executable,
            "-m",
            "fuzz.worker",
            campaign.kind,
            str(campaign.seed),
            str(folder),
            *arguments,
        ]
        (folder / "progress").write_bytes(struct.pack("<qq", -1, 0))
        self._progress = folder / "progress"
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
        guard = threading.Thread(target=self._stop_hanging_input, daemon=True)
        guard.start()
        for text in required(self._process.stdout):
            line = json.loads(text)
            if "done" in line:
                self.done = line["done"]
                self._ended = True
                self._campaign.add_counts(line)
            else:
                self._campaign.add_finding(line)
        status = self._process.wait()
        guard.join()
        self._errors.seek(0)
        errors = self._errors.read().decode(errors="replace")
        self._errors.close()
        if self._ended:
            return None
        number, since = self._current_input()
        if number < 0:
            raise RuntimeError(f"a process of kind {self._campaign.kind} did not start: {errors}")
        category = self._killed or f"died ({status})"
        places = [line.strip() for line in errors.splitlines() if "retalis/" in line]
        place = self._subject() or (places[0].split("retalis/")[-1] if places else "somewhere")
        self._campaign.add_finding(
            {
                "key": f"{category} {place}",
                "category": category,
                "detail": errors[-1500:],
                "place": place,
                "kind": self._campaign.kind,
                "seed": self._campaign.seed,
                "number": number,
                "since": since,
                "again": False,
            }
        )
        return number

    def _current_input(self) -> Any:
        return struct.unpack("<qq", self._progress.read_bytes()[:16])

    def _subject(self) -> str:
        return self._progress.read_bytes()[16:].rstrip(b"\0").decode(errors="replace")

    def _stop_hanging_input(self) -> None:
        """End the process if it hangs at an input."""
        previous, since, used_cpu = None, time.monotonic(), 0.0
        while True:
            try:
                self._process.wait(POLL_INTERVAL_SECONDS)
                return
            except subprocess.TimeoutExpired:
                pass
            current, now, cpu = self._current_input(), time.monotonic(), self._cpu()
            if current != previous or current[0] < 0:
                previous, since, used_cpu = current, now, cpu
            elif cpu - used_cpu > MAX_INPUT_CPU_SECONDS or now - since > MAX_INPUT_SECONDS:
                self._killed = "hang" if cpu - used_cpu > MAX_INPUT_CPU_SECONDS else "blocked"
                self._process.send_signal(signal.SIGABRT)  # faulthandler prints the stack
                return

    def _cpu(self) -> float:
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            return 0.0
        return (int(fields[11]) + int(fields[12])) / _TICKS
