"""The tests of the rules pass with the fused paths switched off: they do nothing but the same in fewer calls.

By default all paths are switched off together; with ``RETALIS_TEST_FUSED=1`` also each of them alone, which takes
minutes.
"""

import os
import subprocess
import sys
from importlib.util import find_spec

import pytest
from events.fused.switching import PATHS
from source import ROOT

SHARED = ["-n", str(os.cpu_count() or 1)] if find_spec("xdist") else []
ALONE = [[path] for path in PATHS] if os.environ.get("RETALIS_TEST_FUSED") == "1" else []


@pytest.mark.slow
@pytest.mark.parametrize("off", [[*PATHS], *ALONE], ids=" ".join)
def test_the_tests_of_rules_pass_without(off):
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow and not fused",
    ]
    run = subprocess.run(
        [*command, "-p", "events.fused.switching", "test/events", "--without-fused", *off, *SHARED],
        cwd=str(ROOT),
        env={**os.environ, "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT / 'test'}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    assert run.returncode == 0, run.stdout.decode(errors="replace")[-4000:]
