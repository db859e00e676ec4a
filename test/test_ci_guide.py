"""Jobs for CI on the page about tests: their commands are documented, and their steps work as a shell script."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from page_snippet_runner import FENCE, ROOT
from ruamel.yaml import YAML
from subprocess_python_path import python_path

pytestmark = [pytest.mark.docs, pytest.mark.slow]

PAGE = ROOT / "docs" / "how-to" / "test-in-ci.md"
COMMANDS = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
GITHUB, GITLAB = ".github/workflows/retalis.yml", ".gitlab-ci.yml"


def named_fences() -> Dict[str, str]:
    """Return the files of the page by name."""
    fences = FENCE.finditer(PAGE.read_text(encoding="utf-8"))
    return {fence["name"]: fence["text"] for fence in fences if fence["name"]}


def list_steps(name: str) -> List[str]:
    """Return the commands of a job for CI."""
    job: Any = YAML(typ="safe", pure=True).load(named_fences()[name])
    if name == GITLAB:
        return list(job["retalis"]["script"])
    return [step["run"] for step in job["jobs"]["test"]["steps"] if "run" in step]


def write_program(folder: Path) -> None:
    """Write the program of the page."""
    for name, text in named_fences().items():
        if name.startswith("program/") and name != "program/tests/faster.yaml":
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")


def run_steps(name: str, folder: Path) -> Tuple[int, str]:
    """Run the commands of a job, except those of pip, as a shell script; return the exit status and the output."""
    interpreter = f"PYTHONPATH={shlex.quote(python_path())} {shlex.quote(sys.executable)}"
    steps = [step for step in list_steps(name) if not step.startswith("pip ")]
    script = "\n".join([f'retalis() {{ {interpreter} -m retalis "$@"; }}', "set -eo pipefail", *steps])
    process = subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        env={"PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    )
    return process.returncode, process.stdout


@pytest.mark.parametrize("name", [GITHUB, GITLAB])
def test_commands_of_job_are_documented(name: str) -> None:
    steps = [shlex.split(step) for step in list_steps(name)]
    assert [step[:2] for step in steps] == [["pip", "install"], ["retalis", "check"], ["retalis", "test"]]
    for program, command, *arguments in steps[1:]:
        (section,) = re.findall(
            rf"^## {program} {command}\n(.*?)(?=^## )", COMMANDS, re.DOTALL | re.MULTILINE
        )
        options = [argument for argument in arguments if argument.startswith("-")]
        assert options
        assert [option for option in options if f"`{option}" not in section] == []


@pytest.mark.parametrize("name", [GITHUB, GITLAB])
def test_job_installs_from_address_in_variable(name: str) -> None:
    variable = "$RETALIS_REPOSITORY" if name == GITLAB else "${{ vars.RETALIS_REPOSITORY }}"
    assert shlex.split(list_steps(name)[0]) == ["pip", "install", f"retalis @ git+https://{variable}"]


@pytest.mark.parametrize("name", [GITHUB, GITLAB])
def test_steps_of_job_pass_and_write_results(name: str, tmp_path: Path) -> None:
    write_program(tmp_path)
    assert run_steps(name, tmp_path) == (0, "program: no errors, no warnings\n2 passed\n")
    assert 'tests="2"' in (tmp_path / "results.xml").read_text(encoding="utf-8")


def test_job_fails_if_a_case_fails(tmp_path: Path) -> None:
    write_program(tmp_path)
    rules = tmp_path / "program" / "eventRules.txt"
    rules.write_text(rules.read_text(encoding="utf-8").replace("within 10", "within 5"), encoding="utf-8")
    status, output = run_steps(GITHUB, tmp_path)
    assert status == 1
    assert "1 passed, 1 failed" in output
    assert 'failures="1"' in (tmp_path / "results.xml").read_text(encoding="utf-8")


def test_job_fails_if_the_check_has_a_warning(tmp_path: Path) -> None:
    write_program(tmp_path)
    (tmp_path / "program" / "pub_sub.xml").write_text("<publish_subscribe/>", encoding="utf-8")
    status, output = run_steps(GITLAB, tmp_path)
    assert status == 2
    assert "RT1102" in output
    assert not (tmp_path / "results.xml").exists()
