"""Rounds of each case leave no objects behind."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from subprocess_python_path import python_path

from .cases import CASES

TEST = Path(__file__).resolve().parents[1]

MAX_OBJECTS = 150
"""Objects that may remain for other reasons than the rounds."""

PREDICATE = "a predicate whose clauses were all retracted exists, and fails"
EXPECTED_LEAKS = {
    "clauses_of_new_predicates": PREDICATE,
    "clauses_that_are_called": PREDICATE,
    "rule_files": PREDICATE,
}
"""Reasons why objects of a case remain."""

NAMES = [name for name in CASES if name not in EXPECTED_LEAKS]


@pytest.fixture(scope="module")
def remaining() -> Any:
    """Return the number of objects that each case leaves behind."""
    environment = {**os.environ, "PYTHONPATH": python_path(TEST)}
    command = [sys.executable, "-m", "leaks", "--rounds", "200", *NAMES]
    return json.loads(
        subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_case_leaves_no_objects(name: Any, remaining: Any) -> None:
    assert remaining[name] < MAX_OBJECTS
