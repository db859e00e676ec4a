"""Goals of others than the program may not change flags, unless the settings allow it."""

import pytest

from retalis import Engine, PrologError, Settings, atom
from retalis.engine.client_requests import add_rule, ask, run_restricted
from retalis.prolog.syntax.term_reader import read_term

SET = "set_etalis_flag(event_consumption_policy, unrestricted)"
OWN = "null do set_etalis_flag(event_consumption_policy, chronological) <- own(_).\n"
REFUSED = "~allow_flags"


def make(rules="", **settings):
    engine = Engine(settings=Settings(**settings))
    engine.load(rules=OWN + ":- dynamic helper/0.\n" + rules)
    return engine


def policy(engine):
    ((found,),) = (one.values() for one in engine.query("get_etalis_flag(event_consumption_policy, X)"))
    return found.name


def terms(engine, *texts):
    return [read_term(text, engine.operators, "text").term for text in texts]


@pytest.mark.parametrize(
    "goal",
    [
        SET,
        "set_prolog_flag(double_quotes, atom)",
        "set_prolog_flag(mine, 1)",
        "create_prolog_flag(mine, 1, [])",
        "unknown(_, fail)",
        f"G = {SET}, call(G)",
        "G =.. [set_etalis_flag, event_consumption_policy, unrestricted], once((true, G))",
        f"findall(x, {SET}, _)",
        f"assertz((helper :- {SET})), helper",
        f"compile_event_rules([(:- {SET})])",
        f"event(synchronized(x, {SET}, []))",
    ],
)
def test_queries_are_refused(goal, caplog):
    engine = make()
    engine.event("first", 1)
    before = engine.query("current_prolog_flag(double_quotes, X), current_prolog_flag(unknown, Y)")
    try:
        ask(engine, goal)
        text = caplog.text
    except PrologError as error:
        text = error.message
    assert REFUSED in text
    assert policy(engine) == "recent"
    assert engine.query("current_prolog_flag(double_quotes, X), current_prolog_flag(unknown, Y)") == before
    assert not engine.query("current_prolog_flag(mine, X)")


def test_an_unchanged_program_may_be_reset_and_a_changed_one_not():
    engine = make()
    engine.call(SET)
    with pytest.raises(PrologError, match=REFUSED):
        ask(engine, "reset_etalis")
    engine = make()
    ask(engine, "reset_etalis")


def test_the_settings_may_allow_it():
    engine = make(allow_flags=True)
    ask(engine, SET)
    assert policy(engine) == "unrestricted"


def test_the_owner_and_the_programs_own_rules_may():
    engine = make(":- set_etalis_flag(event_consumption_policy, recent_2).")
    assert policy(engine) == "recent_2"
    engine.event("own(1)", 1)
    assert policy(engine) == "chronological"
    engine.query(SET)
    assert policy(engine) == "unrestricted"
    ask(engine, "event(own(2))")
    assert policy(engine) == "chronological"


@pytest.mark.parametrize(
    "rule",
    [
        f"null do {SET} <- a(_).",
        f"x <- a(_) where {SET}.",
        f"x <- a(X) where (X > 0, {SET}, X > 0).",
        f"x <- a(_) event_multiply {SET}.",
        f"synchronized(x, {SET}, []) <- a(_).",
        f"null do (G = {SET}, call(G)) <- a(_).",
        "a2(X) <- a(X). a3(X) <- a2(X).",
    ],
)
def test_rules_that_others_have_added_are_refused(rule, caplog):
    engine = make("".join(f"b{at + 1}(X) <- b{at}(X).\n" for at in range(8)))
    for one in rule.split(". "):
        add_rule(engine, one.replace("a(", "b8(") if "null" in one else one)
    engine.event("a(1)", 1)
    engine.event("b0(1)", 2)
    engine.event("a(_)", 3)
    assert policy(engine) == "recent"
    assert (REFUSED in caplog.text) == (SET in rule)


def test_rules_that_others_have_added_are_refused_after_a_change_of_flags(caplog):
    engine = make()
    add_rule(engine, f"synchronized(x, {SET}, []) <- a(_).")
    engine.event("own(1)", 1)  # connects all rules anew
    engine.event("a(1)", 2)
    assert policy(engine) == "chronological"
    assert REFUSED in caplog.text


def test_conditions_of_services_are_refused(caplog):
    engine = make()
    event, condition, free = terms(engine, "a(_)", SET, "_")
    run_restricted(engine, lambda: engine.add_memory(event, [condition], free, atom("m"), 5))
    run_restricted(engine, lambda: engine.add_subscription(event, [condition], free, atom("out"), atom("s")))
    engine.event("a(1)", 1)
    assert policy(engine) == "recent"
    assert "subscription s" in caplog.text and "memory m" in caplog.text and REFUSED in caplog.text
    engine.load(goals=f"memorize(c(_), [{SET}], _, own, 5)")
    engine.event("c(1)", 2)
    assert policy(engine) == "unrestricted"


def test_goals_as_text_that_are_allowed_are_any_goals():
    engine = make(allow_goals=True)
    engine.post_text(SET)
    assert policy(engine) == "unrestricted"
