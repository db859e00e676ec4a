"""``examples/cookbook``: the rospy node of each recipe has the same outputs as its rules, and its folder is complete.

`test_program_cases.py` runs the test cases of the rules.
"""

import ast
import logging
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, List, Tuple

import pytest
from examples.simulated_rospy import SECOND, START, RobotWorld, to_slots

from retalis import BagReader, Definitions, Playback
from retalis.cli.command_line import main

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "cookbook"
RECIPES = sorted(path.parent for path in FOLDER.glob("*/eventRules.txt"))
FILES = {
    "README.md",
    "eventRules.txt",
    "goalPredicates.txt",
    "messages.py",
    "node.py",
    "pub_sub.xml",
    "tests",
}

COMPILED_ONLY = {"places"}
"""Recipes whose nodes are only compiled, because they need a buffer of tf2, which `RobotWorld` does not have."""


@pytest.mark.slow
@pytest.mark.parametrize("folder", RECIPES, ids=lambda path: path.name)
def test_node_has_outputs_of_rules(
    folder: Path,
    recipes: ModuleType,
    definitions: Definitions,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    outputs = play(folder, recipes, definitions, tmp_path / "recipe.bag", caplog)
    assert outputs
    assert main(["check", "--strict", str(folder)]) == 0
    if folder.name not in COMPILED_ONLY:
        expected = [(round(time, -3), topic, data) for time, topic, data in outputs]  # stamps rise by 1 ns
        assert run_node(folder, recipes, definitions) == expected


def play(
    folder: Any, recipes: ModuleType, definitions: Any, path: Any, caplog: pytest.LogCaptureFixture
) -> Any:
    """Return the outputs of a recipe for its bag: time, topic and bytes. Nothing may be reported."""
    recipes.make_bag(folder, path, definitions)
    problems: List[Any] = []
    playback = Playback(folder, problems.append)
    with BagReader(path) as bag, caplog.at_level(logging.WARNING):
        outputs = [(output.time, output.topic, output.data) for output in playback.run(bag)]
    assert (problems, caplog.messages) == ([], [])
    return outputs


def run_node(folder: Path, recipes: ModuleType, definitions: Any) -> List[Tuple[Any, ...]]:
    """Return the outputs of the node of a recipe for the same messages: time, topic and bytes."""
    assert recipes.START * SECOND == START
    recipe = recipes.Recipe(folder)
    types = {topic: definitions.find(name) for topic, name in recipe.topics.items()}
    messages = [(time, topic, types[topic], slots) for time, topic, slots in recipe.messages()]
    published = RobotWorld(definitions).run(folder / "node.py", messages)
    return [(time, topic, encode(message, recipes, definitions, time)) for time, topic, message in published]


def encode(message: Any, recipes: ModuleType, definitions: Any, time: Any) -> bytes:
    term = recipes.to_term(message.definition, to_slots(message), time)
    return definitions.encoder(message.definition).encode(term)


@pytest.mark.parametrize("folder", RECIPES, ids=lambda path: path.name)
def test_recipe_is_complete(folder: Path) -> None:
    assert {
        path.name for path in folder.iterdir() if path.suffix != ".bag" and path.name != "__pycache__"
    } == FILES
    page = (folder / "README.md").read_text(encoding="utf-8")
    (rules,) = re.findall(r"```prolog\n(.*?)```", page, re.DOTALL)
    assert rules == (folder / "eventRules.txt").read_text(encoding="utf-8")
    assert "(node.py)" in page
    assert f"`retalis test examples/cookbook/{folder.name}`" in page
    assert len(page.splitlines()) < 70
    ast.parse((folder / "node.py").read_text(encoding="utf-8"), feature_version=(3, 8))
    targets = re.findall(r"\]\(([\w./]+)\)", page)
    assert [target for target in targets if not (folder / target).exists()] == []


def test_index_names_each_recipe_once() -> None:
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"\]\((\w+)/README.md\)", index)) == [path.name for path in RECIPES]


def test_command_writes_bag(
    recipes: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "some.bag"
    for _ in range(2):  # an existing bag is replaced
        monkeypatch.setattr(sys, "argv", ["make_bag.py", str(FOLDER / "heartbeat"), "--output", str(path)])
        assert recipes.main() == 0
    assert capsys.readouterr().out.splitlines() == [str(path)] * 2
    with BagReader(path) as bag:
        assert bag.messages == 14
    monkeypatch.setattr(sys, "argv", ["make_bag.py", str(tmp_path)])
    with pytest.raises(SystemExit):
        recipes.main()
    assert "is no recipe" in capsys.readouterr().err


def test_unknown_slot_is_an_error(recipes: ModuleType, definitions: Definitions) -> None:
    with pytest.raises(SystemExit, match="std_msgs/Bool has no slot daat"):
        recipes.to_term(definitions.find("std_msgs/Bool"), {"daat": True}, 0)
