"""Table of event operators: coverage by the tests, and operators of the Prolog reader."""

import re
import subprocess
import sys

from events import operator_table
from fuzz.kinds import rules as fuzzed
from subprocess_python_path import python_path

from retalis.events.language.event_operators import EVENT_OPERATORS, PAIR_OPERATORS, OperatorKind
from retalis.events.streams.aggregates import AGGREGATES


def test_tests_cover_all_operators() -> None:
    """The tests have their own table of operators, as an independent definition."""
    names = {
        operator.spellings[0]
        for operator in EVENT_OPERATORS
        if operator.kind not in (OperatorKind.RULE, OperatorKind.UNSUPPORTED)
    }
    assert set(PAIR_OPERATORS) == set(operator_table.PAIRS)
    assert set(AGGREGATES) == set(operator_table.AGGREGATES)
    assert names <= {re.sub(r"\W.*", "", row) for row in operator_table.ROWS} | {
        "do",
        "aggregate",
        "with",
        "absent",
        "not_preceded",
    }
    written = " ".join((*fuzzed.SIDES, *fuzzed.GOALS, *fuzzed.STREAMS, "do"))
    assert all(re.search(rf"\b{name}\b", written) for name in names)


def test_prolog_reader_has_no_event_operators() -> None:
    program = (
        "from retalis.prolog.syntax.operators import Operators\n"
        "print('seq' in Operators.prolog(), 'mod' in Operators.prolog())\n"
        "import retalis\n"
        "print('seq' in retalis.Operators.prolog())\n"
    )
    env = {"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"}
    result = subprocess.run(
        [sys.executable, "-c", program], env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.stderr == ""
    assert result.stdout == "False True\nTrue\n"
