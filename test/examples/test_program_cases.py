"""Test files of the example programs: each case passes, and the cases of a program use all parts of it."""

import re
from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Tuple

import pytest

from retalis import Definitions
from retalis.testing.case_definition import Case
from retalis.testing.case_file import read_case_file
from retalis.testing.case_processes import run_cases
from retalis.testing.case_run import CaseResult
from retalis.testing.rule_coverage import merge_parts

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = [
    ROOT / "application_source",
    ROOT / "examples" / "fleet",
    ROOT / "examples" / "nao-tf",
    ROOT / "examples" / "stops",
    *sorted(path.parent for path in (ROOT / "examples" / "cookbook").glob("*/eventRules.txt")),
]
CALCULATIONS = {
    "application_source": ("Time=[Sec,NSec]", "unquoted(Name,N)"),
    "cloud_zone": ("format(",),
    "dark_image": ("X is W//4",),
    "docking": ("misses(M)",),
    "door": ("t1(S)",),
    "drop_out": ("valid(Least,Most,D)->",),
    "fleet": ("t1(S)",),
    "hysteresis": ("mean(M)->",),
    "joint_effort": ("atom_concat(",),
    "last_seen": ("Place=",),
    "map_cell": ("format(",),
    "meeting": ("text(A,Verb,B,Text)",),
    "obstacle": ("Start is ceiling(",),
    "person_and_speech": ("plain(Who,W)",),
    "places": ("pose(", "place_at(X,Y,Place)"),
    "rate": ("format(",),
    "zones": ("zone_at(X,Y,Zone)", "atomic_list_concat("),
}
"""Beginnings of the conditions of a program that are never false, because they only calculate values of a rule."""

PATTERNS = ROOT / "examples" / "patterns"
"""Folder with cases that have their rules in the file."""

NAME = re.compile(r"^  - name: (.+)$", re.MULTILINE)

pytestmark = pytest.mark.slow


def list_files(program: Path) -> List[Path]:
    return sorted((program / "tests").glob("*.yaml"))


def list_cases() -> Iterator[Tuple[Path, str]]:
    """Yield the program and the name of each case; the files are not parsed, because each run collects them."""
    for program in PROGRAMS:
        for path in list_files(program):
            for name in NAME.findall(path.read_text(encoding="utf-8")):
                yield program, name


class ProgramRun(NamedTuple):
    """The cases of a program by name, and their results."""

    cases: Dict[str, Case]
    results: Dict[str, CaseResult]


class ProgramRuns:
    """The runs of programs: the cases of a program are run together, because they share the loaded program."""

    def __init__(self, definitions: Definitions):
        self._definitions = definitions
        self._runs: Dict[Path, ProgramRun] = {}

    def run(self, program: Path) -> ProgramRun:
        """Return the run of all cases of a program, one after the other."""
        if program not in self._runs:
            cases = [case for path in list_files(program) for case in read_case_file(path)]
            results = dict(run_cases(cases, self._definitions, jobs=1, records_coverage=True))
            self._runs[program] = ProgramRun(
                {case.name: case for case in cases},
                {case.name: results[number] for number, case in enumerate(cases)},
            )
        return self._runs[program]


@pytest.fixture(scope="module")
def runs(definitions: Definitions) -> ProgramRuns:
    return ProgramRuns(definitions)


def name_program(path: Path) -> str:
    return path.name


@pytest.mark.parametrize(
    ("program", "name"), [pytest.param(*case, id=f"{case[0].name}-{case[1]}") for case in list_cases()]
)
def test_case_passes(program: Path, name: str, runs: ProgramRuns) -> None:
    failures = runs.run(program).results[name].failures
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_cases_use_all_parts_of_program(program: Path, runs: ProgramRuns) -> None:
    parts = merge_parts(result.coverage for result in runs.run(program).results.values())
    assert {"rule", "pattern", "subscription"} <= {part.type for part in parts}
    unused = [f"{part.type} {part.text}" for part in parts if not part.uses]
    beginnings = [f"condition 1 false, {begin}" for begin in CALCULATIONS.get(program.name, ())]
    assert len(unused) == len(beginnings), unused
    assert all(text.startswith(begin) for text, begin in zip(unused, beginnings)), unused


@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_all_cases_are_collected(program: Path, runs: ProgramRuns) -> None:
    names = [name for folder, name in list_cases() if folder == program]
    assert names == list(runs.run(program).cases)


@pytest.mark.parametrize("program", PROGRAMS, ids=name_program)
def test_outputs_are_forbidden_by_a_case(program: Path, runs: ProgramRuns) -> None:
    """A program that publishes its alarms for each input would pass all other cases."""
    sequences = [
        sequence
        for case in runs.run(program).cases.values()
        for sequence in case.expectations.sequences
        if sequence.subject == "outputs"
    ]
    assert any(
        sequence.relation == "none" or (sequence.relation == "exactly" and not sequence.items)
        for sequence in sequences
    )


@pytest.mark.parametrize("path", list_files(PATTERNS), ids=lambda path: path.stem)
def test_cases_of_patterns_pass(path: Path, definitions: Definitions) -> None:
    cases = read_case_file(path)
    results = dict(run_cases(cases, definitions, jobs=1))
    assert len(results) == len(cases) > 0
    assert [failure for result in results.values() for failure in result.failures] == []


def test_table_lists_files_of_patterns() -> None:
    links = re.findall(
        r"^\| \[\S+\]\(tests/(\S+)\)", (PATTERNS / "README.md").read_text("utf-8"), re.MULTILINE
    )
    assert sorted(links) == [path.name for path in list_files(PATTERNS)]
