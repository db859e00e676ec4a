"""Warnings about tables whose answers become outdated."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis import Definitions, Engine
from retalis.engine.program_check import check_program

MEMORY = "memorize(pos(P), [], pos(P), pos, 5)\n"
RULES = """
:- discontiguous note/1.
seen(P) <- go where t(P).
moved <- pos(P) where note(P).
note(_).
go(1) <- pos(_).
"""


def messages_of_check(folder: Path, rules: Any, check: str) -> List[Any]:
    """Return the findings of a check in a program without errors."""
    (folder / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>\n")
    (folder / "goalPredicates.txt").write_text(f"compile_event_file('rules.txt')\n{MEMORY}")
    (folder / "rules.txt").write_text(rules)
    findings_of_program = list(check_program(folder, Definitions()))
    assert [finding for finding in findings_of_program if finding.severity == "error"] == []
    return [finding.problem.message for finding in findings_of_program if finding.check == check]


def stale_table_messages(folder: Any, rules: Any) -> Any:
    """Return the findings about tables in a program."""
    return messages_of_check(folder, RULES + rules, "stale-tables")


READS_POS = "t(P) :- prev(pos, pos(P), _, _, [1000,0]).\n"
ADVICE = "and keeps its answers when that changes: write :- table t/1 as incremental"
OPAQUE = "; if this is intended, write :- table t/1 as opaque"


@pytest.mark.parametrize(
    ("rules", "text"),
    [
        (":- table t/1.\n" + READS_POS, f"table t/1 reads memory pos, {ADVICE}{OPAQUE}"),
        (":- table t(_).\n" + READS_POS, f"table t/1 reads memory pos, {ADVICE}{OPAQUE}"),
        (
            ":- table t/1.\nt(P) :- other(P).\nother(P) :- \\+ \\+ findall(P, access_mem(M, P, _), _), M = pos.\n",
            f"table t/1 reads memories, {ADVICE}{OPAQUE}",
        ),
        (
            ":- table t/1.\nt(P) :- pose_chain([pos], [1,0], P).\n",
            f"table t/1 reads memories, {ADVICE}{OPAQUE}",
        ),
        (
            ":- state(docked(R), from(dock(R)), until(undock(R))).\n:- table t/1.\nt(R) :- holds(docked(R)).\n",
            f"table t/1 reads state docked/1, {ADVICE}{OPAQUE}",
        ),
        (
            ":- dynamic q/1.\n:- table t/1.\nt(X) :- q(X).\nnote(P) :- assertz(q(P)).\n",
            f"table t/1 reads q/1, which the program changes, {ADVICE} and :- dynamic q/1 as incremental{OPAQUE}",
        ),
        (
            ":- dynamic q/1 as incremental.\n:- table t/1.\nt(X) :- q(X).\nnote(P) :- retractall(q(P)).\n",
            f"table t/1 reads q/1, which the program changes, {ADVICE}{OPAQUE}",
        ),
        (
            ":- dynamic q/1.\n:- table t/1.\nt(X) :- clause(q(X), true).\ndo_it <- go do assertz(q(1)).\n",
            f"table t/1 reads q/1, which the program changes, {ADVICE} and :- dynamic q/1 as incremental{OPAQUE}",
        ),
        (
            ":- dynamic t/1.\n:- table t/1.\nnote(P) :- assertz(t(P)).\n",
            f"table t/1 reads clauses of its own, {ADVICE}{OPAQUE}",
        ),
        (
            ":- dynamic q/1.\n:- table t/1 as incremental.\nt(X) :- other(X).\nother(X) :- q(X).\n"
            "note(P) :- assertz(q(P)).\n",
            "incremental table t/1 reads q/1, which the program changes, and does not notice changes: "
            "write :- dynamic q/1 as incremental",
        ),
        (
            ":- table t/1, u/1 as incremental.\nt(P) :- u(P).\nu(P) :- prev(pos, pos(P), _, _, [1000,0]).\n",
            f"table t/1 reads memory pos, {ADVICE}{OPAQUE}",
        ),
    ],
)
def test_stale_table_is_reported(tmp_path: Path, rules: str, text: str) -> None:
    assert stale_table_messages(tmp_path, rules) == [text]


def test_each_table_of_chain_is_named(tmp_path: Path) -> None:
    rules = ":- table t/1, u/1.\nt(P) :- u(P).\nu(P) :- prev(pos, pos(P), _, _, [1000,0]).\n"
    assert [text.split(" reads ")[0] for text in stale_table_messages(tmp_path, rules)] == [
        "table t/1",
        "table u/1",
    ]
    opaque = rules.replace("t/1, u/1.", "t/1 as incremental, u/1.")
    assert [text.split(" reads ")[0] for text in stale_table_messages(tmp_path, opaque)] == ["table u/1"]


@pytest.mark.parametrize(
    "rules",
    [
        ":- table t/1 as incremental.\n" + READS_POS,
        ":- table t(_) as incremental.\n" + READS_POS,
        ":- table t/1 as opaque.\n" + READS_POS,
        READS_POS,
        ":- table t/1.\nt(X) :- q(X).\n:- dynamic q/1.\nq(1).\n",
        # facts that are there before the first event
        ":- table t/1.\nt(X) :- q(X).\n:- dynamic q/1.\n:- assertz(q(1)).\n",
        ":- table t/1.\nt(X) :- q(X).\n:- dynamic q/1.\n"
        "begin :- assertz(q(1)), more(2).\nmore(X) :- assertz(q(X)).\n:- begin.\n",
        # a program that decides itself when its tables are evaluated again
        ":- table t/1.\n" + READS_POS + "note(_) :- abolish_all_tables.\n",
        ":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X).\nnote(P) :- assertz(q(P)).\n",
        ":- dynamic([q/1], [incremental(true)]).\n:- table t/1 as incremental.\nt(X) :- q(X).\n"
        "note(P) :- assertz(q(P)).\n",
        ":- dynamic q/1 as opaque.\n:- table t/1 as incremental.\nt(X) :- q(X).\nnote(P) :- assertz(q(P)).\n",
        # a predicate of the program's own by the name of one that reads memories
        ":- table t/1.\nt(X) :- prev(X, 1, 2, 3, 4).\nprev(a, _, _, _, _) :- true.\n",
        # the table reads other predicates than those that change
        ":- dynamic q/1, p/1.\n:- table t/1.\nt(X) :- q(X).\nnote(P) :- assertz(p(P)).\n",
        ":- table t/1.\nt(X) :- length(X, 2).\nuser :- t(_), prev(pos, _, _, _, [1,0]).\n",
    ],
)
def test_table_that_cannot_be_stale_is_not_reported(tmp_path: Path, rules: str) -> None:
    assert stale_table_messages(tmp_path, rules) == []


def test_options_of_declaration_hide_no_mistake(tmp_path: Path) -> None:
    rules = ":- dynamic q/1 as incremental.\n:- table t/1 as incremental.\nt(X) :- q(X), nothing_there(X).\n"
    messages = messages_of_check(tmp_path, rules, "undefined")
    assert [text.split(":")[0] for text in messages] == ["there is no predicate nothing_there/1"]


def test_warnings_have_order_of_declarations(tmp_path: Path) -> None:
    names = [f"t{number}" for number in range(8)]
    tables = "".join(f":- table {name}/1 as incremental.\n{name}(X) :- q(X).\n" for name in names)
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
    (tmp_path / "rules.txt").write_text(
        f":- dynamic q/1.\n{tables}learn(P) :- assertz(q(P)).\nnull do learn(P) <- note(P).\n"
    )
    engine = Engine()
    engine.load_program(tmp_path)
    # The command sorts its findings by their places; the log of a node has the order of the check.
    texts = [warning.message.partition(" reads")[0] for warning in engine.warnings(tmp_path, Definitions())]
    assert [text for text in texts if text.startswith("incremental")] == [
        f"incremental table {name}/1" for name in names
    ]
