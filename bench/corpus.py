#!/usr/bin/env python3
"""Conformity test with Prolog files of other projects: loading in this package and in SWI-Prolog.

    bench/corpus.py FOLDER [--swi-results FILE.json] [--most N] [--seconds S] [--only WORD] [--details FILE.json]

Each folder in FOLDER is a repository; of each, N files are taken (``.pl``, ``.pro``, ``.prolog``), spread over all of
them. A line for each repository says of how many files that SWI-Prolog loads without an error

    loads   this package refuses nothing as a whole,
    whole   it leaves nothing out either: no clause, no directive,
    same    it has as many clauses of each predicate as SWI-Prolog.

Lines after that count what is wrong first in each of the other files. The files are programs of strangers, and their
directives are run: each loads in a process of its own that sees no network and a file system that it cannot write,
with limits of time and memory. Where the system allows no such process, nothing is run.
"""

import argparse
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "src")]

from arguments import above_zero, existing, positive, target  # noqa: E402

from retalis import Engine, Limits, Omission, RetalisError, Settings  # noqa: E402

ENDINGS = (".pl", ".pro", ".prolog")
LARGEST = 300_000
"""Limit for the bytes of a file; longer files are data."""

MEMORY = 2 << 30
CLOSED = ("unshare", "-r", "-n", "-m", "sh", "-c", 'mount -o remount,bind,ro / && exec "$@"', "sh")
"""Prefix of a command that runs without network and without write access."""

_PREDICATES = """
current_prolog_flag(argv, Arguments), last(Arguments, Name), absolute_file_name(Name, File),
catch(load_files(user:File, []), E, print_message(error, E)), nl,
forall(( source_file(Head, File), Head = _:Plain, functor(Plain, Functor, Arity),
         ( predicate_property(Head, number_of_clauses(Clauses)) -> true ; Clauses = 0 ) ),
       format("@@ ~w/~w ~w~n", [Functor, Arity, Clauses])),
format("@@ end~n"), halt
"""


class Loaded(NamedTuple):
    """Result of loading a file.

    Attributes:
        errors: reasons why the file was rejected; for SWI-Prolog, all errors.
        omitted: clauses and directives that were ignored.
        clauses: number of clauses of each predicate; None if unknown.
    """

    errors: List[str]
    omitted: List[str]
    clauses: Optional[Dict[str, int]]


def chosen(folder: Path, most: int, only: str) -> List[Path]:
    """Return the files to load, as paths in the folder."""
    found = []
    for repository in sorted(path for path in folder.iterdir() if path.is_dir()):
        files = sorted(
            path.relative_to(folder)
            for path in repository.rglob("*")
            if path.suffix in ENDINGS and path.is_file() and 0 < path.stat().st_size < LARGEST
        )
        step = max(1.0, len(files) / most)
        found += [files[int(at * step)] for at in range(min(most, len(files)))]
    return [path for path in found if only in str(path)]


def limited(seconds: float) -> None:
    """Limit the resources of a new process, and make it the leader of its own group."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 3))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.setsid()


def closed(command: List[str], path: Path, seconds: float) -> "subprocess.CompletedProcess[str]":
    """Run a command in the folder of a file; raise `subprocess.TimeoutExpired` if it does not end."""
    process = subprocess.Popen(
        [*CLOSED, *command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=str(path.parent),
        env={"PATH": "/usr/bin:/bin", "HOME": "/nonexistent", "LANG": "C.UTF-8"},
        preexec_fn=lambda: limited(seconds),
    )
    try:
        out, err = process.communicate(timeout=4 * seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise
    return subprocess.CompletedProcess(
        command, process.returncode, out.decode("utf-8", "replace"), err.decode("utf-8", "replace")
    )


def swi(path: Path, seconds: float, program: str) -> Loaded:
    """Load a file in SWI-Prolog."""
    command = [program, "-q", "-f", "none", "--no-tty", "-g", _PREDICATES, "--", str(path)]
    try:
        done = closed(command, path, seconds)
    except subprocess.TimeoutExpired:
        return Loaded([f"did not end within {4 * seconds:g} s"], [], None)
    errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    if done.returncode not in (0, 1, 2):
        errors.append(f"ended with status {done.returncode}")
    if "@@ end" not in done.stdout:  # it has ended itself, as programs do
        return Loaded(errors, [], None)
    found = [line.split() for line in done.stdout.splitlines() if line.startswith("@@ ")]
    return Loaded(errors, [], {line[1]: int(line[2]) for line in found if len(line) == 3})


def here(path: Path, seconds: float) -> Loaded:
    """Load a file with this package."""
    command = [sys.executable, str(Path(__file__).resolve()), "--load", str(path), "--seconds", str(seconds)]
    try:
        done = closed(command, path, seconds)
    except subprocess.TimeoutExpired:
        return Loaded([f"did not end within {4 * seconds:g} s"], [], None)
    lines = done.stdout.splitlines()
    try:
        return Loaded(*json.loads(lines[-1]))
    except (ValueError, IndexError):
        return Loaded([f"ended with status {done.returncode}: {done.stderr[-300:]}"], [], None)


def load(path: Path, seconds: float) -> Loaded:
    """Load a file in this process."""
    engine = Engine(settings=Settings(limits=Limits(seconds=seconds), folders=None))
    engine.logic.output = engine.logic.error_output = lambda text: None
    omitted: List[str] = []
    engine.rules.on_warning = lambda one: omitted.append(str(one)) if isinstance(one, Omission) else None
    errors: List[str] = []
    try:
        engine.load_program(path)
    except RetalisError as error:
        errors.append(str(error))
    clauses: Dict[str, int] = Counter()
    for predicate in engine.logic.database.predicates.values():
        for clause in predicate.active_clauses() if predicate.kind == "user" else ():
            if clause.place is not None and clause.place.source == str(path):
                clauses[f"{predicate.functor.name}/{predicate.functor.arity}"] += 1
    return Loaded(errors, omitted, dict(clauses))


_PLACE = re.compile(r"^.*?:\d+:\d+: ")
_NAMES = re.compile(r"'[^']*'|\"[^\"]*\"|\d+")


def kind(message: str) -> str:
    """Return a message without places, numbers and names, so that similar messages can be counted."""
    first = next((line for line in message.splitlines() if line.strip()), message)
    return _NAMES.sub("_", _PLACE.sub("", first))[:100]


def differing(wanted: Loaded, found: Loaded) -> List[str]:
    """Return the predicates with different numbers of clauses."""
    if wanted.clauses is None or found.clauses is None:
        return []
    return [key for key, number in wanted.clauses.items() if found.clauses.get(key, 0) != number]


class Comparison:
    """Counts of loaded files, by repository."""

    def __init__(self) -> None:
        self.rows: Dict[str, List[int]] = defaultdict(lambda: [0, 0, 0, 0])
        self.kinds: Dict[str, List[str]] = defaultdict(list)
        self.details: Dict[str, Any] = {}

    def add(self, name: str, wanted: Loaded, found: Loaded) -> None:
        """Count a file that SWI-Prolog loads."""
        others = differing(wanted, found)
        loads, whole = not found.errors, not found.errors and not found.omitted
        row = self.rows[name.split("/")[0]]
        for at, counts in enumerate((True, loads, whole, loads and not others)):
            row[at] += counts
        self.details[name] = {**found._asdict(), "differing": others}
        wrong = [*found.errors, *found.omitted]
        if wrong or others:
            self.kinds[kind(wrong[0]) if wrong else "other clauses"].append(name)

    def show(self) -> None:
        """Print the table and the most frequent errors."""
        print(f"{'repository':50} {'SWI':>5} {'loads':>6} {'whole':>6} {'same':>6}")
        for name, row in sorted(self.rows.items()):
            print(f"{name:50} {row[0]:5} {row[1]:6} {row[2]:6} {row[3]:6}")
        all_, *others = (sum(row[at] for row in self.rows.values()) for at in range(4))
        shares = " ".join(f"{100 * number / max(1, all_):.1f}%" for number in others)
        print(f"{'all':50} {all_:5} {others[0]:6} {others[1]:6} {others[2]:6}  {shares}")
        for what, names in sorted(self.kinds.items(), key=lambda item: -len(item[1])):
            print(f"{len(names):4} {what}  | {' '.join(names[:2])}")


def results_of_swi(options: argparse.Namespace, files: List[Path]) -> Dict[str, Loaded]:
    """Return SWI-Prolog's results, from a file of results if they are known."""
    known: Dict[str, Loaded] = {}
    kept: Optional[Path] = options.swi_results
    if kept is not None and kept.exists():
        known = {name: Loaded(*one) for name, one in json.loads(kept.read_text(encoding="utf-8")).items()}
    for path in files:
        if str(path) not in known:
            known[str(path)] = swi(options.folder / path, options.seconds, options.swipl)
    if kept is not None:
        kept.write_text(json.dumps(known), encoding="utf-8")
    return known


def is_closed() -> bool:
    """Return whether the system supports isolated processes."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            tried = subprocess.run([*CLOSED, "touch", f"{folder}/a"], capture_output=True, timeout=20)
        except (OSError, subprocess.TimeoutExpired):
            return False
        return tried.returncode == 1 and not os.listdir(folder)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("folder", nargs="?", type=existing, help="holds a folder for each repository")
    add(
        "--swi-results", type=target, metavar="FILE", help="keep what SWI-Prolog does, and take it from there"
    )
    add("--swipl", default="swipl", metavar="PROGRAM", help="SWI-Prolog")
    add("--most", type=positive, default=25, metavar="N", help="files of a repository (25)")
    add("--seconds", type=above_zero, default=10.0, metavar="S", help="CPU time of a file (10)")
    add("--only", default="", metavar="WORD", help="files with this in their names")
    add("--details", type=target, metavar="FILE", help="write all that is known of each file, as JSON")
    add("--load", type=existing, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.load is not None:
        print(json.dumps(load(options.load, options.seconds)))
        return 0
    if options.folder is None:
        parser.error("which folder?")
    if not is_closed():
        parser.error("unshare(1) makes no process without network and with a read-only file system here")
    options.folder = options.folder.resolve()
    files = chosen(options.folder, options.most, options.only)
    known = results_of_swi(options, files)
    comparison = Comparison()
    for path in files:
        wanted = known[str(path)]
        if not wanted.errors:
            comparison.add(str(path), wanted, here(options.folder / path, options.seconds))
    comparison.show()
    if options.details is not None:
        options.details.write_text(json.dumps(comparison.details, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
