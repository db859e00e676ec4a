"""Knowledge bases with libraries of SWI-Prolog, queried by rules: constraints, CHR, triples."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis import Engine, PrologError, Settings
from retalis.prolog.swi.libswipl import SwiLibrary

FOLDER = Path(__file__).resolve().parent / "bases"


def derived_events(swi: Any, rules: Any, *events: Any) -> List[Any]:
    """Return the events that rules derive from events, as text; the fixture `swi` requires the library."""
    engine = Engine(settings=Settings(allow_swi=True))
    engine.load(rules=rules, folder=FOLDER)
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    for time, event in enumerate(events, 1):
        engine.event(event, time)
    return [output for output in outputs if output not in events]


@pytest.mark.slow
def test_rules_query_finite_domain_constraints(swi: SwiLibrary) -> None:
    rules = (
        ":- use_swi('shifts.pl').\n"
        "planned(H) <- wanted(W) where (plan(W, H), H = [10|_]).\n"
        "leaves(T) <- late(Now) where earliest(Now, 5, T).\n"
        "no_plan(W) <- wanted(W) where \\+ plan(W, _).\n"
    )
    assert derived_events(
        swi, rules, "wanted([any,at(8),after(10)])", "wanted([at(9),at(9)])", "late(17)"
    ) == [
        "planned([10,8,11])",
        "no_plan([at(9),at(9)])",
        "leaves(20)",
    ]


@pytest.mark.slow
def test_rules_query_constraint_handling_rules(swi: SwiLibrary) -> None:
    rules = (
        ":- use_swi('doors.pl').\n"
        "near(L) <- doors(From, Doors) where ways(From, Doors, L).\n"
        "forgotten <- doors(_, [door(A, B, _)|_]) where shut(A, B).\n"
    )
    doors = "[door(hall,kitchen,2),door(kitchen,cellar,3),door(hall,cellar,9)]"
    assert derived_events(swi, rules, f"doors(hall,{doors})", "doors(cellar,[door(cellar,hall,1)])") == [
        "near([cellar-5,kitchen-2])",
        "forgotten",
        "near([hall-1])",
        "forgotten",
    ]


@pytest.mark.slow
def test_rules_query_and_change_triples(swi: SwiLibrary) -> None:
    rules = (
        ":- use_swi('things.pl').\n"
        "stands(T, P) <- asked(T) where on(T, P).\n"
        "kinds_of(T, K) <- asked(T) where kinds(T, K).\n"
        "moved(T) do move(T, P) <- seen(T, P).\n"
    )
    events = ["asked(mug1)", "seen(mug1,floor)", "asked(mug1)", "seen(mug1,table)"]
    assert derived_events(swi, rules, *events) == [
        "stands(mug1,table)",
        "kinds_of(mug1,['Mug','Thing','Vessel'])",
        "moved(mug1)",
        "stands(mug1,floor)",
        "kinds_of(mug1,['Mug','Thing','Vessel'])",
        "moved(mug1)",
    ]


def test_variable_with_chr_constraints_is_refused(swi: SwiLibrary, tmp_path: Path) -> None:
    (tmp_path / "order.pl").write_text(
        ":- module(order, [under/2]).\n:- use_module(library(chr)).\n:- chr_constraint under(?, ?).\n"
        "under(X, X) <=> fail.\nunder(X, Y), under(Y, X) <=> fail.\n"
    )
    engine = Engine(settings=Settings(allow_swi=True))
    engine.load(rules=":- use_swi('order.pl').", folder=tmp_path)
    assert engine.call("under(a, b)")
    assert not engine.call("under(a, a)")
    with pytest.raises(PrologError, match="has constraints in SWI-Prolog"):
        engine.query("under(X, b)")
