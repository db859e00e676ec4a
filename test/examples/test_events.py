"""``examples/events``: the command in the README of each folder has the expected output."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from retalis.cli.command_line import main
from retalis.events.language.event_operators import PAIR_OPERATORS
from retalis.events.matches.match_policies import ConsumptionPolicy

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "events"
EXAMPLES = sorted(path.parent for path in FOLDER.glob("*/rules.txt"))
COMMAND = "    PYTHONPATH=../../../src python3 -m retalis "


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_example_has_expected_output(
    example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / example.name
    shutil.copytree(str(example), str(folder))
    if (folder / "outputs.txt").exists():
        (folder / "outputs.txt").unlink()
    monkeypatch.chdir(folder)
    readme = (example / "README.md").read_text(encoding="utf-8")
    (command,) = [line for line in readme.splitlines() if line.startswith(COMMAND)]
    assert main(shlex.split(command[len(COMMAND) :])) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out == (example / "expected.txt").read_text(encoding="utf-8")
    if (example / "outputs.txt").exists():
        assert (folder / "outputs.txt").read_text() == (example / "outputs.txt").read_text()


def test_each_operator_and_policy_has_example() -> None:
    names = {path.name for path in EXAMPLES}
    others = [
        "or",
        "cnot",
        "fnot",
        "star_times",
        "ntimes",
        "aggregate",
        "where",
        "within",
        "check",
        "do",
        "event_multiply",
    ]
    assert {*PAIR_OPERATORS, *others} <= names
    assert {f"policy_{policy.value}" for policy in ConsumptionPolicy} <= names


def test_search_path_of_commands_has_package() -> None:
    (path,) = set(re.findall(r"PYTHONPATH=(\S+)", (FOLDER / "README.md").read_text(encoding="utf-8")))
    assert EXAMPLES
    assert all((example / path / "retalis" / "__main__.py").is_file() for example in EXAMPLES)


def test_index_names_all_examples() -> None:
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\((\w+)/README.md\)", index)) == {path.name for path in EXAMPLES}
