"""Facts that are refused or reported, because they are probably goals or rules with another arrow."""

import pytest
from asserting_accessors import name_of, place_of
from events.load_problems import warnings_of

from retalis import Engine, ProgramErrors


@pytest.mark.parametrize(
    ("goal", "key"),
    [
        ("set_etalis_flag(out_of_order,on)", "set_etalis_flag/2"),
        ("memorize(a(X),[],a(X),m,10)", "memorize/5"),
        ("prev(a,b,c,d,e)", "prev/5"),
        ("append(a,b,c)", "append/3"),
        ("t1(5)", "t1/1"),
        ("reset_db", "reset_db/0"),
    ],
)
def test_fact_of_built_in_predicate_is_refused(goal: str, key: str) -> None:
    engine = Engine()
    with pytest.raises(ProgramErrors) as caught:
        engine.load(rules=f"c <- a.\nfact(1).\n  {goal}.\n")
    (error,) = caught.value.errors
    assert error.message.startswith(f"a fact of {key} would replace the built-in predicate")
    assert "write :- before a goal" in error.message
    assert (place_of(error).line, place_of(error).column) == (3, 3)
    assert not engine.call("catch(fact(1), _, fail)")
    assert engine.logic.is_system_predicate(next(k for k in engine.logic.names() if str(k) == key))


@pytest.mark.parametrize(
    "program",
    [
        "append([], L, L).\nappend([H|T], L, [H|R]) :- append(T, L, R).",
        ":- dynamic append/3.\nappend([], x, x).",
        ":- dynamic((other/1, append/3)).\nappend([], x, x).",
        ":- discontiguous([append/3]).\nappend([], x, x).",
        "append(X, Y, Z) :- fail.\nappend([], x, x).",
    ],
)
def test_program_may_define_library_predicates(program: str) -> None:
    engine = Engine()
    engine.load(rules=program)
    assert name_of(engine.query("append([], x, X)")[0]["X"]) == "x"
    engine.load(rules="append(more, x, y).")  # the predicate belongs to the program
    assert engine.call("append(more, x, y)")


def test_facts_named_as_loader_forms_are_stored() -> None:
    engine = Engine()
    engine.load(rules="db(x). static(wall). prolog(p(1)). module(m, [x]). print_trigger(a/1).")
    for goal in (
        "db(x)",
        "x",
        "static(wall)",
        "wall",
        "prolog(p(1))",
        "p(1)",
        "module(m, [x])",
        "etalis_module(m, _)",
    ):
        assert engine.call(goal), goal


@pytest.mark.parametrize(
    ("text", "is_reported"), [("hot(X) - t(X).", True), ("a - b.", True), ("a - 1.", False)]
)
def test_dash_instead_of_arrow_is_reported(text: str, is_reported: bool) -> None:
    warnings = warnings_of(f"b <- a.\n{text}")
    assert [(line, column) for line, column, _ in warnings] == [(2, text.index("-") + 1)] * is_reported
    assert all("<-" in message and ":-" in message for _, _, message in warnings)
