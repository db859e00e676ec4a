"""Change sampled places of the source one at a time and run the tests; list the changes that no test notices.

    PYTHONPATH=src:test python3 -m mutation --places 200 --seed 1 --log mutants.txt

Needs ``pytest-cov``. All fast tests that need no ROS run once to record which of them execute which line; with
``--slow`` the slow ones too, with ``--tests`` only those of some files or folders, which takes less time and may miss
the test that notices a mutant. For each mutant the tests that execute its line run, those of its package first, until
one fails. A mutant that makes these tests take much longer than before counts as noticed, too. ``equivalent.txt``
lists mutants that change nothing that a user can observe, with the reason; they are not sampled. The exit status is 1
if more than ``--most`` percent survive.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from coverage import CoverageData

from .mutants import mutants

ROOT = Path(__file__).resolve().parents[2]
EQUIVALENT = Path(__file__).with_name("equivalent.txt")

GROUPS = {
    "matches": ("events/matches/*.py", "events/network/join_node.py", "events/network/event_rule.py"),
    "dispatch": ("events/dispatch/*.py", "events/fused/*.py", "engine/event_input.py"),
    "encoding": ("messages/*.py",),
    "memories": ("events/knowledge/*.py",),
    "limits": (
        "prolog/machine/resource_limits.py",
        "engine/runtime/watchdog.py",
    ),
    "files": ("prolog/files/file_sandbox.py", "prolog/files/source_files.py"),
}
"""Paths below ``src/retalis`` that matter most, by subject. Each subject gives the same number of mutants."""

TIMEOUT_SECONDS = 300
MAX_TESTS_AT_ONCE = 400
"""Tests given to one pytest process: its command line is limited."""
SAME_STATEMENT_LINES = 8
"""Lines before a mutant's line that may begin its statement; coverage counts some statements by their first line."""


def main(argv: Any) -> int:
    """Run a campaign; return the exit status."""
    options = _options(argv)
    sampled = _sample(options)
    results: Counter[Any] = Counter()
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder, open(options.log, "a") as log:
        copy = _Copy(Path(folder) / "copy", options.tests, options.slow)
        copy.record(sorted({path for _, path, _, _ in sampled}))
        for number, (group, path, mutant, text) in enumerate(sampled, 1):
            outcome = copy.try_mutant(path, mutant)
            results[group, outcome == "survived"] += 1
            line = f"{outcome}: {path}:{mutant.line}: {mutant.operator}: {text}"
            print(f"[{number}/{len(sampled)}] {line}", flush=True)
            log.write(line + "\n")
            log.flush()
    return _summarize(results, options.most)


def _options(argv: Any) -> Any:
    parser = argparse.ArgumentParser(prog="python3 -m mutation", description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--places", type=int, default=200, help="number of mutants (default: %(default)s)")
    add("--seed", type=int, default=1, help="seed of the sample (default: %(default)s)")
    add("--groups", nargs="+", choices=[*GROUPS], default=[*GROUPS], help="subjects to sample (default: all)")
    add("--paths", nargs="+", metavar="GLOB", help="sample these modules instead, below src/retalis")
    add("--log", default=os.devnull, metavar="FILE", help="append a line for each mutant to this file")
    add("--again", metavar="FILE", help="try only the mutants that survived according to this log")
    add("--tests", nargs="+", default=[], metavar="PATH", help="files or folders of tests (default: all)")
    add("--slow", action="store_true", help="run the slow tests, too")
    add(
        "--most",
        type=float,
        default=5,
        metavar="PERCENT",
        help="tolerated share of survivors (default: %(default)s)",
    )
    return parser.parse_args(argv)


def _sample(options: Any) -> Any:
    """Return (group, path, mutant, description) for each sampled mutant."""
    groups = {"paths": options.paths} if options.paths else {name: GROUPS[name] for name in options.groups}
    equivalent = {line.rsplit(" -- ", 1)[0] for line in EQUIVALENT.read_text().splitlines() if " -- " in line}
    again = None
    if options.again:
        lines = Path(options.again).read_text().splitlines()
        again = {_key(line) for line in lines if line.startswith("survived: ")}
    sampled: List[Any] = []
    for name, patterns in groups.items():
        places: List[Any] = []
        paths = {path for pattern in patterns for path in (ROOT / "src" / "retalis").glob(pattern)}
        for path in sorted(paths):
            source = path.read_text(encoding="utf-8")
            relative = path.relative_to(ROOT).as_posix()
            for mutant in mutants(source):
                text = mutant.describe(source)
                if f"{relative}: {text}" in equivalent:
                    continue
                if again is None or (relative, mutant.operator, text) in again:
                    places.append((name, relative, mutant, text))
        count = len(places) if again is not None else min(len(places), -(-options.places // len(groups)))
        sampled += random.Random(f"{options.seed} {name}").sample(places, count)
    return sampled


def _key(line: str) -> Tuple[Any, ...]:
    """Return what identifies a mutant in a line of the log, whatever its line number is now."""
    _, place, operator, text = line.split(": ", 3)
    return place.rsplit(":", 1)[0], operator, text


def _summarize(results: Any, most: Any) -> int:
    total = sum(results.values())
    survived = sum(count for (_, survives), count in results.items() if survives)
    for group in sorted({name for name, _ in results}):
        count = results[group, True] + results[group, False]
        print(f"{group}: {results[group, True]} of {count} survive")
    share = 100 * survived / total if total else 0
    print(f"{survived} of {total} mutants survive ({share:.1f} %)")
    return 1 if share > most else 0


class _Copy:
    """A copy of the repository in which one module at a time is mutated and tested.

    Args:
        root: folder of the copy.
        paths: files and folders of the tests; all tests if empty.
        slow: run the slow tests, too.
    """

    def __init__(self, root: Path, paths: "list[str]", slow: bool) -> None:
        ignore = shutil.ignore_patterns(
            ".git", "__pycache__", ".hypothesis", ".*_cache", "*.egg-info", ".nox", "venv"
        )
        shutil.copytree(str(ROOT), str(root), ignore=ignore)
        self._root = root
        self._paths = paths
        self._slow = slow
        self._tests: Dict[Any, Any] = {}

    def record(self, paths: List[Any]) -> None:
        """Run the tests and record which of them execute which lines of some modules.

        Raises:
            SystemExit: a test fails without a mutant.
        """
        settings = self._root / "mutation.ini"
        included = "\n    ".join(paths)
        settings.write_text(f"[run]\ninclude =\n    {included}\n", encoding="utf-8")
        arguments = [
            "--cov",
            "--cov-config",
            "mutation.ini",
            "--cov-context",
            "test",
            "--cov-report",
            "",
            "-n",
            "2",
        ]
        selection = [] if self._slow else ["-m", "not slow"]
        start = time.monotonic()
        status, output = self._run(
            [*arguments, *selection, "--ignore", "test/ros1", "--ignore", "test/mutation", *self._paths], None
        )
        if status != pytest.ExitCode.OK:
            raise SystemExit(f"the tests fail without a mutant:\n{output[-5000:]}")
        print(f"{time.monotonic() - start:.0f} s to record the tests", flush=True)
        data = CoverageData(str(self._root / ".coverage"))
        data.read()
        for path in paths:
            contexts = data.contexts_by_lineno(str(self._root / path))
            self._tests[path] = {
                # A context is "test|phase"; the parameters in a test's name may contain "|", too.
                line: sorted({name.rpartition("|")[0] for name in names if name})
                for line, names in contexts.items()
            }

    def try_mutant(self, path: Any, mutant: Any) -> str:
        """Return ``survived``, ``timeout`` or ``noticed``."""
        tests = self._tests_of(path, mutant.line)
        module = self._root / path
        source = module.read_text(encoding="utf-8")
        # Python tells a changed source by its size and its time in seconds, neither of which a mutant need change.
        for compiled in (module.parent / "__pycache__").glob(module.stem + ".*"):
            compiled.unlink()
        for first in range(0, len(tests), MAX_TESTS_AT_ONCE):
            some = tests[first : first + MAX_TESTS_AT_ONCE]
            module.write_text(mutant.apply(source), encoding="utf-8")
            try:
                status, _ = self._run(["-x", "-n", "0", *some], TIMEOUT_SECONDS)
            except subprocess.TimeoutExpired:
                return "timeout"
            finally:
                module.write_text(source, encoding="utf-8")
            if status == pytest.ExitCode.USAGE_ERROR:
                # Pytest found a test or conftest.py to be missing or broken: is it so because of the mutant?
                self._require_tests(some)
            if status != pytest.ExitCode.OK:
                return "noticed"
        return "survived"

    def _require_tests(self, tests: Any) -> None:
        """Exit unless pytest finds tests without a mutant; otherwise each mutant would count as noticed."""
        status, output = self._run(["--collect-only", "-n", "0", *tests], TIMEOUT_SECONDS)
        if status != pytest.ExitCode.OK:
            raise SystemExit(f"recorded tests are not found:\n{output[-5000:]}")

    def _tests_of(self, path: Any, line: Any) -> List[Any]:
        """Return the tests that execute a line, those of its package first."""
        lines = self._tests[path]
        executed: List[Any] = next(
            (lines[at] for at in range(line, line - SAME_STATEMENT_LINES, -1) if lines.get(at)), []
        )
        package = Path("test", *Path(path).relative_to("src/retalis").parts[:-1]).as_posix()
        return sorted(executed, key=lambda name: (not name.startswith(package), name))

    def _run(self, arguments: List[Any], timeout: Any) -> Tuple[Any, ...]:
        """Run pytest; return its exit status and the output."""
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", *arguments]
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1" if timeout else ""}
        # Packages may be in folders that only this variable names. The copy has this package and the tests itself.
        folders = environment.pop("PYTHONPATH", "").split(os.pathsep)
        own_folders = {ROOT / "src", ROOT / "test"}
        environment["PYTHONPATH"] = os.pathsep.join(
            folder for folder in folders if Path(folder).resolve() not in own_folders
        )
        environment.pop("PYTEST_XDIST_WORKER", None)  # of the run of the tests that has started this program
        process = subprocess.Popen(
            command,
            cwd=self._root,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.communicate()
            raise
        return process.returncode, output.decode(errors="replace")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
