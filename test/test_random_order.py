"""Random order of tests, in runs of pytest with two modules."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, Tuple

import pytest
from subprocess_python_path import ROOT, python_path

pytestmark = pytest.mark.slow

MODULE = """
import pytest

@pytest.mark.parametrize("number", range(10))
def test_alone(number):
    pass

class TestTogether:
    @pytest.mark.parametrize("number", range(10))
    def test_method(self, number):
        pass
"""


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """Return a function that runs the modules with a seed; it returns the output and the tests in their order."""
    for name in "ab":
        (tmp_path / f"test_{name}.py").write_text(MODULE)

    def run(*arguments: Any, seed: Any = None) -> Tuple[Any, ...]:
        environment = {**os.environ, "PYTHONPATH": python_path(ROOT / "test")}
        environment.pop("RETALIS_ORDER_SEED", None)
        if seed is not None:
            environment["RETALIS_ORDER_SEED"] = seed
        options = ["-p", "random_order", "-p", "no:cacheprovider", "-p", "no:xdist", "-vv", *arguments]
        command = [sys.executable, "-m", "pytest", *options]
        process = subprocess.run(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
        return process.stdout, re.findall(
            r"^(test_\w\.py::\S+) (?:PASSED|FAILED)", process.stdout, re.MULTILINE
        )

    return run


def test_seed_repeats_order(run: Any) -> None:
    output, tests = run()
    (seed,) = re.findall(
        r"^random order of tests: RETALIS_ORDER_SEED=(\d+) repeats it$", output, re.MULTILINE
    )
    assert run(seed=seed)[1] == tests
    assert len(tests) == 40


def test_other_seed_has_other_order(run: Any) -> None:
    first, second = run(seed="1")[1], run(seed="2")[1]
    assert first != second
    assert sorted(first) == sorted(second)


def test_part_of_tests_keeps_order(run: Any) -> None:
    tests = run(seed="3")[1]
    part = run("test_b.py", "-k", "test_method", seed="3")[1]
    assert part == [test for test in tests if test.startswith("test_b.py") and "test_method" in test]
    assert len(part) == 10


def test_modules_and_classes_are_not_mixed(run: Any) -> None:
    tests = run(seed="4")[1]
    for node, count in [("test_a.py", 20), ("test_b.py::TestTogether", 10)]:
        positions = [position for position, test in enumerate(tests) if test.startswith(f"{node}::")]
        assert positions == list(range(positions[0], positions[0] + count))


def test_failed_run_ends_with_seed(run: Any, tmp_path: Path) -> None:
    (tmp_path / "test_c.py").write_text("def test_false():\n    assert False\n")
    output, _ = run("test_c.py", seed="5")
    line = "random order of tests: RETALIS_ORDER_SEED=5 repeats it\n"
    assert output.count(line) == 2
    assert output.index("AssertionError") < output.rindex(line)
