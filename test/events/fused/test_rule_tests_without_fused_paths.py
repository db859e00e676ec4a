"""The tests of the rules pass with the fused paths switched off: results do not depend on fused paths.

By default all paths are switched off together, for some folders. With ``RETALIS_TEST_FUSED=1`` all tests of the rules
run with each path switched off alone, too, which takes ten minutes.
"""

import os
import subprocess
import sys
from importlib.util import find_spec
from typing import Any

import pytest
from events.fused.fused_path_plugin import PATHS
from parsed_sources import ROOT
from subprocess_python_path import python_path

WHOLE = os.environ.get("RETALIS_TEST_FUSED") == "1"
FOLDERS = ["test/events"] if WHOLE else ["test/events/rules", "test/events/dispatch"]
SHARED = ["-n", str(os.cpu_count() or 1)] if find_spec("xdist") else []


@pytest.mark.slow
@pytest.mark.parametrize("off", [[*PATHS], *([path] for path in PATHS if WHOLE)], ids=" ".join)
def test_rule_tests_pass_without_fused_path(off: Any) -> None:
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
        [*command, "-p", "events.fused.fused_path_plugin", *FOLDERS, "--without-fused", *off, *SHARED],
        cwd=str(ROOT),
        env={**os.environ, "PYTHONPATH": python_path(ROOT / "test")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    assert run.returncode == 0, run.stdout.decode(errors="replace")[-4000:]
