"""The benchmark of goals in SWI-Prolog runs and says what it should."""

import re
import subprocess
import sys

import pytest
from source import ROOT

from retalis import UsageError
from retalis.prolog.swi.libswipl import find_library


@pytest.mark.slow
def test_it_tells_what_goals_cost():
    try:
        find_library()
    except UsageError as error:
        pytest.skip(str(error))
    command = [sys.executable, str(ROOT / "bench" / "swi.py"), "--runs", "1", "--limits"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    said = [re.sub(r"[\d.]+", "N", line) for line in done.stdout.splitlines()]
    assert "a further solution: N us" in said
    assert "reachability alone: N ms for N answers" in said
    assert sum(line.startswith("reachability by an event") for line in said) == 3
