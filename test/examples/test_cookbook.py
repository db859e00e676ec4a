"""``examples/cookbook``: each recipe gives what it says, and its rospy node, fed with the same messages, the same."""

import ast
import importlib.util
import logging
import re
import sys
from pathlib import Path

import pytest
from examples.roboworld import BEGAN, SECOND, RobotWorld, to_slots

from retalis import BagReader, Playback
from retalis.cli.command_line import main

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "cookbook"
RECIPES = sorted(path.parent for path in FOLDER.glob("*/eventRules.txt"))
FILES = {
    "README.md",
    "eventRules.txt",
    "expected.txt",
    "goalPredicates.txt",
    "messages.py",
    "node.py",
    "pub_sub.xml",
}

WITHOUT_STAND_IN = {"places"}
"""Recipes whose nodes need more of ROS than the stand-in has: a buffer of tf2. They are only compiled."""


@pytest.fixture(scope="module")
def recipes():
    """Return the script that makes the bags; the NAO's has the same name."""
    spec = importlib.util.spec_from_file_location("cookbook_make_bag", str(FOLDER / "make_bag.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("folder", RECIPES, ids=lambda path: path.name)
def test_a_recipe_gives_what_it_says_and_its_node_the_same(folder, recipes, definitions, tmp_path, caplog):
    outputs = played(folder, recipes, definitions, tmp_path / "recipe.bag", caplog)
    lines = [f"output({text},{topic}).\n" for _, topic, text, _ in outputs]
    assert "".join(lines) == (folder / "expected.txt").read_text(encoding="utf-8")
    assert main(["check", "--strict", str(folder)]) == 0
    if folder.name not in WITHOUT_STAND_IN:
        wanted = [(round(time, -3), topic, data) for time, topic, _, data in outputs]  # stamps rise by 1 ns
        assert said(folder, recipes, definitions) == wanted


def played(folder, recipes, definitions, path, caplog):
    """Return what a recipe publishes over its bag: time, topic, text and bytes. Nothing may be reported."""
    recipes.make_bag(folder, path, definitions)
    problems = []
    playback = Playback(folder, problems.append)
    with BagReader(path) as bag, caplog.at_level(logging.WARNING):
        found = [(one.time, one.topic, playback.engine.show(one.term), one.data) for one in playback.run(bag)]
    assert (problems, caplog.messages) == ([], [])
    return found


def said(folder, recipes, definitions):
    """Return what a recipe's node publishes when it gets the recipe's messages: time, topic and bytes."""
    assert recipes.START * SECOND == BEGAN
    recipe = recipes.Recipe(folder)
    kinds = {topic: definitions.find(name) for topic, name in recipe.topics.items()}
    messages = [(time, topic, kinds[topic], slots) for time, topic, slots in recipe.messages()]
    published = RobotWorld(definitions).run(folder / "node.py", messages)
    return [(time, topic, encoded(message, recipes, definitions, time)) for time, topic, message in published]


def encoded(message, recipes, definitions, time):
    return definitions.encoder(message.kind).encode(recipes.to_term(message.kind, to_slots(message), time))


@pytest.mark.parametrize("folder", RECIPES, ids=lambda path: path.name)
def test_a_recipe_is_whole(folder):
    assert {path.name for path in folder.iterdir() if path.suffix not in (".bag", "")} == FILES
    page = (folder / "README.md").read_text(encoding="utf-8")
    (rules,) = re.findall(r"```prolog\n(.*?)```", page, re.DOTALL)
    assert rules == (folder / "eventRules.txt").read_text(encoding="utf-8")
    assert "(node.py)" in page and len(page.splitlines()) < 70
    ast.parse((folder / "node.py").read_text(encoding="utf-8"), feature_version=(3, 8))
    for target in re.findall(r"\]\(([\w./]+)\)", page):
        assert (folder / target).exists(), target


def test_the_index_names_all():
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"\]\((\w+)/README.md\)", index) == list(
        dict.fromkeys(re.findall(r"\]\((\w+)/README.md\)", index))
    )
    assert set(re.findall(r"\]\((\w+)/README.md\)", index)) == {path.name for path in RECIPES}


def test_the_command_makes_a_bag(recipes, tmp_path, monkeypatch, capsys):
    path = tmp_path / "some.bag"
    for _ in range(2):  # a bag that is there is written anew
        monkeypatch.setattr(sys, "argv", ["make_bag.py", str(FOLDER / "heartbeat"), "--output", str(path)])
        assert recipes.main() == 0
    assert capsys.readouterr().out.splitlines() == [str(path)] * 2
    with BagReader(path) as bag:
        assert bag.messages == 14
    monkeypatch.setattr(sys, "argv", ["make_bag.py", str(tmp_path)])
    with pytest.raises(SystemExit):
        recipes.main()
    assert "is no recipe" in capsys.readouterr().err


def test_slots_that_are_none_are_named(recipes, definitions):
    with pytest.raises(SystemExit, match="std_msgs/Bool has no slot daat"):
        recipes.to_term(definitions.find("std_msgs/Bool"), {"daat": True}, 0)
