"""Node ``retalis`` with a program that uses SWI-Prolog."""

from pathlib import Path
from typing import Any

import pytest

from retalis import UsageError
from retalis.prolog.swi.libswipl import find_library

KB = """\
:- module(doors, [way/2, forever/0]).
:- table way/2.
way(X, Y) :- door(X, Y).
way(X, Y) :- way(X, Z), door(Z, Y).
door(hall, kitchen).
door(kitchen, cellar).
forever :- forever.
"""
RULES = ":- use_swi('doors.pl').\nreached(Y) <- asked(X, Y) where way(X, Y).\n"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "program"
    folder.mkdir()
    goals = "compile_event_file('rules.txt')\nmemorize(reached(_), [], _, m, 5)\n"
    for name, text in (
        ("pub_sub.xml", "<publish_subscribe/>"),
        ("goalPredicates.txt", goals),
        ("rules.txt", RULES),
        ("doors.pl", KB),
    ):
        (folder / name).write_text(text)
    return folder


def start(space: Any, program: Any, *words: Any) -> Any:
    space.start_master()
    node = space.executable("retalis_node")
    return space.start(node, f"_program:={program}", "_direct:=false", *words)


def test_swi_predicates_are_goals_of_node(devel: Any, program: Path) -> None:
    try:
        find_library()
    except UsageError as error:
        pytest.skip(str(error))
    start(devel, program, "_allow_swi:=true", "_max_seconds:=0.5")
    devel.expect(lambda nodes, services: "/retalis/query" in services)
    devel.post_events("asked(hall,cellar)")
    devel.expect(lambda nodes, services: "reached(cellar)" in devel.query("access_mem(m, R, _)"))
    assert "kitchen" in devel.query("way(hall, kitchen), X = kitchen")
    assert "seconds" in devel.query("forever")
    assert "cellar" in devel.query("way(kitchen, X)")
