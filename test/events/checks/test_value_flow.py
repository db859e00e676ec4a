"""Values that flow through the events, memories, states and predicates of a program."""

import re
from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import required, stream_clock
from page_snippet_runner import ROOT

from retalis import Definitions, Engine
from retalis.engine.program_check import check_program
from retalis.events.checks.program_model import ProgramModel
from retalis.events.checks.value_flow import ValueFlow, find_conflicting_flows, find_impossible_flows
from retalis.events.checks.value_kinds import kind_of, overlaps
from retalis.events.program.topic_configuration import Topics
from retalis.prolog.terms.timestamps import from_seconds
from retalis.prolog.terms.types import functor

FENCE = re.compile(r"^```prolog\n(.*?)^```", re.MULTILINE | re.DOTALL)
EVENT = re.compile(r"(\S.*?) \[([\d.]+),([\d.]+)\](?:, |$)")


def model_of(definitions: Any, rules: str) -> ProgramModel:
    engine = Engine()
    engine.load(rules=rules)
    return ProgramModel(engine.rules, engine.knowledge, definitions, Topics())


def impossible_values(definitions: Any, rules: Any) -> List[Any]:
    return [error.message for error in find_impossible_flows(model_of(definitions, rules))]


def type_conflicts(definitions: Any, rules: Any) -> List[Any]:
    return [error.message for error in find_conflicting_flows(model_of(definitions, rules))]


TEXT = "text(X) <- std_msgs__0__String(X).\n"
BOOL = "flag(X) <- std_msgs__0__Bool(X).\n"
NUMBER = "level(X) <- std_msgs__0__Float32(X).\n"
QUOTES = "a text keeps its quotes in events, write '\"anna\"'"


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (
            BOOL + "d <- flag(1).",
            "argument 1 of flag/1 is true or false (data of std_msgs/Bool), never 1: write true or false",
        ),
        (
            TEXT + "d <- text(anna).",
            f"argument 1 of text/1 is a text (data of std_msgs/String), never anna: {QUOTES}",
        ),
        (
            TEXT + 'd <- text("anna").',
            f'argument 1 of text/1 is a text (data of std_msgs/String), never "anna": {QUOTES}',
        ),
        (
            NUMBER + "d <- level('5').",
            "argument 1 of level/1 is a number (data of std_msgs/Float32), never '5': write 5",
        ),
        (
            "status(ready) <- boot. d <- status('\"ready\"').",
            "argument 1 of status/1 is an atom (ready in line 1), never '\"ready\"': "
            "write the atom without double quotes, as ready",
        ),
        (
            'name("anna") <- boot. d <- name(anna).',
            'argument 1 of name/1 is a string ("anna" in line 1), never anna: write "anna"',
        ),
    ],
)
def test_constant_of_no_event_is_reported_with_advice(
    definitions: Definitions, rules: str, message: str
) -> None:
    assert impossible_values(definitions, rules) == [message]
    assert type_conflicts(definitions, rules) == []


@pytest.mark.parametrize(
    ("rules", "value"),
    [
        # Heads, through chains and alternatives.
        (TEXT + "b(X) <- text(X). c(X) <- b(X) where true. d <- c(anna).", "argument 1 of c/1 is a text"),
        (TEXT + "c(X) <- text(X) or std_msgs__0__String(X). d <- c(anna).", "argument 1 of c/1 is a text"),
        (TEXT + "c(X) <- text(X) seq absent(stop, 5). d <- c(anna).", "argument 1 of c/1 is a text"),
        (TEXT + "c(X) <- (go seq text(X)) cnot stop. d <- c(anna).", "argument 1 of c/1 is a text"),
        (TEXT + "exceptionAlarm(c(X), 5) <- text(X). d <- c(anna).", "argument 1 of c/1 is a text"),
        (TEXT + "c(X) <- text(X) with throttle(5). d <- c(anna).", "argument 1 of c/1 is a text"),
        (TEXT + "d <- go seq absent(text(anna), 5).", "argument 1 of text/1 is a text"),
        (TEXT + "c(X) <- text(Y) where X = Y. d <- c(anna).", "argument 1 of c/1 is a text"),
        # Aggregates, windows and row patterns.
        (
            TEXT + "c(X) <- aggregate(last(V), text(V), X, last(5)). d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        (
            TEXT + "c(X) <- aggregate([count, first(V)], text(V), [_, X], every(5)). d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        (
            TEXT + "c(X, N) <- aggregate(count, text(X), N, last(5)). d <- c(anna, _).",
            "argument 1 of c/2 is a text",
        ),
        ("c(N) <- aggregate(count, text(_), N, last(5)). d <- c(many).", "argument 1 of c/1 is a number"),
        ("c(N) <- go seq aggregate(count, text(_), N). d <- c(many).", "argument 1 of c/1 is a number"),
        (
            NUMBER + "c(A) <- aggregate(avg(V), level(V), A, last(5)). d <- c(high).",
            "argument 1 of c/1 is a number",
        ),
        (
            NUMBER + "c(L) <- aggregate(list(V), level(V), L, last(5)). d <- c(high).",
            "argument 1 of c/1 is a list",
        ),
        (
            TEXT + "c(X) <- aggregate(last(V), text(V), X, steps([one, two])). d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        # States, and the goals that emit events.
        (TEXT + ":- state(on(X), from(text(X)), until(off)). d <- on(anna).", "argument 1 of on/1 is a text"),
        (TEXT + "null do new_event(c(X), 1, 2) <- text(X). d <- c(anna).", "argument 1 of c/1 is a text"),
        (
            TEXT
            + "null do send(X) <- text(X). send(X) :- room(X), new_event(c(X), 1, 2). room('\"a\"'). d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        # Results of goals, memories and predicates.
        (NUMBER + "c(Y) <- level(X) where Y is X * 2. d <- c(high).", "argument 1 of c/1 is a number"),
        ("c(X) <- go where room(X). room('\"hall\"'). d <- c(anna).", "argument 1 of c/1 is a text"),
        (
            TEXT
            + ":- memorize(text(X), [], o(X), m, 5). c(X) <- go where prev(m, o(X), 1, _, _). d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        (
            TEXT + ":- memorize(text(X), [], X, m, 5). c(X) <- go where access_mem(m, X, _). d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        (
            TEXT
            + ":- memorize(text(X), [], o(X), m, 5). synchronized(c(X), access_mem(m, o(X), _), [[m, 1]]) <- go. "
            "d <- c(anna).",
            "argument 1 of c/1 is a text",
        ),
        (
            ":- declare_event(reading(celsius:float)). c(X) <- reading(X). d <- c(high).",
            "argument 1 of c/1 is a number",
        ),
    ],
)
def test_values_flow_to_an_event(definitions: Definitions, rules: str, value: str) -> None:
    (message,) = impossible_values(definitions, rules)
    assert message.startswith(f"{value} (")


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (
            "ok(N) <- std_msgs__0__String(N) where allowed(N). allowed(anna). allowed(bob).",
            "N is a text (data of std_msgs/String), and argument 1 of allowed/1 is an atom (anna in line 1): "
            f"these are never equal; {QUOTES}",
        ),
        (
            'ok(X) <- text(X) where \\+ allowed(X). allowed("anna").',
            'X is a text (data of std_msgs/String), and argument 1 of allowed/1 is a string ("anna" in line 2): '
            f"these are never equal; {QUOTES}",
        ),
        (
            "ok(X) <- text(X) where code(X). code(5).",
            "X is a text (data of std_msgs/String), and argument 1 of code/1 is a number (5 in line 2): these are "
            "never equal; for the number in a text write sub_atom(X, 1, _, 1, Atom), atom_number(Atom, Number)",
        ),
        ("ok(X) <- text(X) where X == anna.", f"X is a text (data of std_msgs/String), never anna: {QUOTES}"),
        (
            "ok(X) <- text(X) where X > 5.",
            "X is a text (data of std_msgs/String), not a number: compare texts with == or \\==",
        ),
        (
            "m(A) <- aggregate(avg(X), text(X), A, last(5)).",
            "X is a text (data of std_msgs/String): avg collects numbers",
        ),
        (
            "both(X) <- text(X) seq std_msgs__0__Float32(X).",
            "X is a text (data of std_msgs/String), and here it is a number (data of std_msgs/Float32): these are "
            "never equal; for the number in a text write sub_atom(X, 1, _, 1, Atom), atom_number(Atom, Number)",
        ),
        (
            "std_msgs__0__String(X) <- std_msgs__0__Float32(Y) where X is Y + 1.",
            "X is a number (result of is) and goes into a text (data of std_msgs/String): "
            "make a text of it, as with format(atom(Text), '\"~w\"', [X])",
        ),
        (
            "std_msgs__0__Float32(X) <- text(X).",
            "X is a text (data of std_msgs/String) and goes into a number (data of std_msgs/Float32): "
            "for the number in a text write sub_atom(X, 1, _, 1, Atom), atom_number(Atom, Number)",
        ),
    ],
)
def test_conflict_is_reported_with_advice(definitions: Definitions, rules: str, message: str) -> None:
    rules = rules if rules.startswith("ok(N)") else TEXT + rules
    assert type_conflicts(definitions, rules) == [message]
    assert impossible_values(definitions, rules) == []


@pytest.mark.parametrize(
    ("rules", "conflict"),
    [
        # Predicates: clauses, recursion, comparisons in bodies, calls with constants, assertions.
        (
            "ok(X) <- text(X) where friend(X). friend(X) :- known(X). known(anna). known(X) :- friend(X).",
            "X is a text (data of std_msgs/String), and argument 1 of friend/1 is an atom (anna in line 2)",
        ),
        (
            "ok(X) <- text(X) where warm(X). warm(T) :- T > 38.",
            "X is a text (data of std_msgs/String), and argument 1 of warm/1 is used as a number",
        ),
        (
            "ok(X) <- text(X) where anna(X). anna(N) :- N == anna.",
            "X is a text (data of std_msgs/String), and argument 1 of anna/1 is an atom (anna in line 2)",
        ),
        (
            'ok <- go where known(anna). known("anna").',
            'argument 1 of known/1 is a string ("anna" in line 2), never anna',
        ),
        (
            ":- dynamic seen/1. null do assertz(seen(X)) <- text(X). ok <- go where seen(anna).",
            "argument 1 of seen/1 is a text (data of std_msgs/String), never anna",
        ),
        (
            ":- dynamic n/1. null do assertz(n(0)) <- a. null do (retract(n(X)), Y is X + 1, assertz(n(Y))) <- b. "
            "ok <- go where n(zero).",
            "argument 1 of n/1 is a number (0 in line 2), never zero",
        ),
        ("ok(X) <- text(X) where (X = anna ; fail).", "X is a text (data of std_msgs/String), never anna"),
        (
            "ok(X) <- text(X) where (go(X) -> true ; X == anna). go(_).",
            "X is a text (data of std_msgs/String), never anna",
        ),
        (
            "ok(X) <- text(X) where findall(Y, (known(Y), Y == X), _). known(anna).",
            "Y is an atom (anna in line 2), and X is a text (data of std_msgs/String)",
        ),
        (
            "ok(X) <- text(X) where atom_length(X, X).",
            "X is a text (data of std_msgs/String), and the result of atom_length/2 is a number",
        ),
        # Memories, subscriptions, states.
        (
            ":- memorize(text(X), [], o(X), m, 5). ok <- go where access_mem(m, o(anna), _).",
            "argument 1 of the record of memory m is a text (data of std_msgs/String), never anna",
        ),
        (
            ":- memorize(text(X), [], X, m, 5). ok <- go where (prev(m, Y, 1, _, _), Y == anna).",
            "Y is a text (data of std_msgs/String), never anna",
        ),
        (
            ":- memorize(text(X), [X == anna], X, m, 5).",
            "memory m: this variable is a text (data of std_msgs/String), never anna",
        ),
        (
            ":- subscribe(text(X), [known(X)], X, topic, id). known(anna).",
            "a subscription of topic topic: this variable is a text (data of std_msgs/String), and "
            "argument 1 of known/1 is an atom",
        ),
        (
            ":- state(on(X), from(text(X)), until(off)). ok <- go where holds(on(anna)).",
            "argument 1 of on/1 is a text (data of std_msgs/String), never anna",
        ),
        (
            ":- state(on(X), from(text(X)), until(off)). ok <- go where (holds(on(Y)), Y > 3).",
            "Y is a text (data of std_msgs/String), not a number",
        ),
        # Joins of the program's own events, and conditions of row patterns.
        (
            "level(X) <- std_msgs__0__Float32(X). ok(X) <- text(X) seq level(X).",
            "X is a text (data of std_msgs/String), and argument 1 of level/1 is a number (data of std_msgs/Float32)",
        ),
        (
            "ok(N) <- aggregate(count, text(X), N, steps([one where X == anna])).",
            "X is a text (data of std_msgs/String), never anna",
        ),
    ],
)
def test_values_flow_to_a_goal(definitions: Definitions, rules: str, conflict: str) -> None:
    (message,) = type_conflicts(definitions, TEXT + rules)
    assert message.startswith(conflict)


@pytest.mark.parametrize(
    "rules",
    [
        TEXT + "d <- text('\"anna\"').",
        BOOL + "d <- flag(true).",
        "ok(N) <- std_msgs__0__String(N) where allowed(N). allowed('\"anna\"').",
        # Events of other programs, and events and clauses that are not known.
        TEXT + "input_event(text/1). d <- text(anna).",
        "d <- other(anna). e <- other(1).",
        TEXT + "d <- text(anna). null do (thing(T), new_event(T, 1, 2)) <- go. thing(text(anna)).",
        TEXT + "null do ins_event_rule(R) <- add(R). d <- text(anna).",
        ":- dynamic allowed/1. allowed(anna). ok(N) <- std_msgs__0__String(N) where allowed(N).",
        "allowed(anna). null do assertz(C) <- learn(C). ok(N) <- std_msgs__0__String(N) where allowed(N).",
        ":- table allowed/1. allowed(anna). ok(N) <- std_msgs__0__String(N) where allowed(N).",
        # Several sources, and unbound arguments.
        TEXT + "text(anna) <- boot. d <- text(bob).",
        "c(X) <- std_msgs__0__String(X) or go. d <- c(anna).",
        "allowed(anna). allowed(X) :- extra(X). extra('\"b\"'). ok(N) <- std_msgs__0__String(N) where allowed(N).",
        "allowed(_). ok(N) <- std_msgs__0__String(N) where allowed(N).",
        TEXT + ":- memorize(text(X), [], o(X), m, 5). :- memorize(go, [], o(anna), m2, 5). "
        "d <- go where access_mem(m2, o(anna), _).",
        # Variables that are unbound at the goal, or have another value in another scope.
        "ok <- go where (findall(X, name(X), _), findall(X, code(X), _)). name(anna). code(5).",
        "ok <- go where (\\+ name(X), X = 5). name(anna).",
        "ok(X) <- go where (name(X) ; code(X)). name(anna). code(5). d <- ok(anna). e <- ok(5).",
        # Names of numbers, timestamps, arrays, and numbers of any type.
        NUMBER + "d <- level(nan). e <- level(inf). f <- level(1).",
        "c(S) <- std_msgs__0__Header(_, S, _). d <- c([_, _]). e(S) <- c(S) where S > 5.",
        "c(R) <- sensor_msgs__0__LaserScan{ranges: R}. m(A) <- aggregate(avg(R), c(R), A, last(5)). d <- m([_|_]).",
        "d(X) <- go where (X = 1 + 2, X > 2).",
        "limit(1 + 2). d <- go where (limit(X), X > 2).",
        # Slots that accept other values than they deliver.
        "std_msgs__0__Bool(X) <- go where X is 1.",
        BOOL + "std_msgs__0__String(X) <- flag(X).",
        "std_msgs__0__String(X) <- go where room(X). room(hall). room(pi).",
        "std_msgs__0__Time(X) <- go where instant(X). instant(datime(2026,1,1,0,0,0,0)). instant([1,2]).",
        # Rules without any source of values.
        "loop(X) <- loop(X) where true. d <- loop(3). e(X) <- loop(X) seq std_msgs__0__String(X).",
        "p(X) :- p(X). ok <- go where p(3).",
    ],
)
def test_possible_and_unknown_values_are_not_reported(definitions: Definitions, rules: str) -> None:
    assert impossible_values(definitions, rules) + type_conflicts(definitions, rules) == []


def test_use_in_rule_of_message_is_reported_once(check: Any) -> None:
    assert [finding.problem.code for finding in check("ok <- std_msgs__0__String(X) where X == anna.")] == [
        "RT1106"
    ]
    assert [finding.problem.code for finding in check("ok <- std_msgs__0__String(anna).")] == ["RT1105"]


@pytest.fixture
def check(tmp_path: Path, definitions: Definitions) -> Any:
    """Return a function that checks rules, without the findings about missing topics."""

    def run(rules: Any) -> List[Any]:
        path = tmp_path / "rules.txt"
        path.write_text(rules + "\n")
        return [finding for finding in check_program(path, definitions) if finding.problem.code != "RT1201"]

    return run


def test_comment_suppresses_finding_of_constant(check: Any) -> None:
    (finding,) = check(TEXT + "d <- go seq text(anna).")
    assert (finding.check, finding.problem.code) == ("values", "RT1105")
    assert (finding.problem.place.line, finding.problem.place.column) == (2, 18)
    assert check(TEXT + "d <- go seq text(anna). % retalis: ignore=RT1105") == []


def test_constant_of_other_file_has_its_place(tmp_path: Path, check: Any) -> None:
    (tmp_path / "people.pl").write_text("allowed(anna).\n")
    (finding,) = check(":- consult('people.pl').\nok(N) <- std_msgs__0__String(N) where allowed(N).")
    assert finding.problem.code == "RT1106"
    assert "argument 1 of allowed/1 is an atom (anna in line 1 of people.pl)" in finding.problem.message


def test_change_of_a_file_is_checked_at_reload(tmp_path: Path, definitions: Definitions) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    rules = tmp_path / "eventRules.txt"
    rules.write_text(TEXT + "d <- text('\"anna\"').\n")
    engine = Engine()
    engine.load_program(tmp_path)

    def codes() -> List[Any]:
        return [warning.code for warning in engine.warnings(tmp_path, definitions)]

    assert "RT1105" not in codes()
    rules.write_text(TEXT + "d <- text(anna).\n")
    engine.reload(tmp_path)
    assert "RT1105" in codes()


def test_values_flow_through_long_chains_in_any_order(definitions: Definitions) -> None:
    rules = [f"e{number + 1}(X) <- e{number}(X) where true." for number in range(300)]
    clauses = [f"p{number + 1}(X) :- p{number}(X)." for number in range(300)]
    ends = "e0(X) <- std_msgs__0__String(X). d <- e300(anna). ok(X) <- e300(X) where p300(X). p0(5)."
    model = model_of(definitions, "\n".join([*reversed(rules), *reversed(clauses), ends]))
    assert len(list(find_impossible_flows(model))) == len(list(find_conflicting_flows(model))) == 1


@pytest.mark.slow
def test_events_of_examples_have_kinds(definitions: Definitions) -> None:
    checked = 0
    for page in sorted((ROOT / "docs").rglob("*.md")):
        for text in FENCE.findall(page.read_text(encoding="utf-8")):
            for line in text.splitlines():
                if line.startswith("% ") and "=>" in line:
                    checked += _check_events(
                        definitions, text, EVENT.findall(line[2:].split("=>")[0].strip())
                    )
    assert checked > 100


def _check_events(definitions: Any, rules: Any, arrivals: Any) -> int:
    """Run an example, compare its events with their computed kinds, and return the number of compared arguments."""
    engine = Engine()
    engine.load(rules=rules)
    flow = ValueFlow(ProgramModel(engine.rules, engine.knowledge, definitions, Topics()))
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append(term))
    for term, start, end in arrivals:
        stream_clock(engine).move_to(from_seconds(float(end)))
        engine.event(term, *(float(stamp) if "." in stamp else int(stamp) for stamp in (start, end)))
    checked = 0
    for event in outputs:
        for argument, value_types in (
            zip(event[1:], flow.kinds_of_event(event[0]) or ()) if isinstance(event, tuple) else ()
        ):
            value_type = kind_of(argument)
            assert value_type is None or overlaps(value_type, value_types), engine.show(event)
            checked += 1
    return checked


def test_kinds_of_a_predicate_are_those_of_its_clauses(definitions: Definitions) -> None:
    clauses = "p(X, Y) :- q(X), Y is 1. q(anna). q([1]). r(_)."
    rules = "e(X, Y) <- t where p(X, Y). f(X) <- t where r(X). g(L) <- t where append(_, _, L)."
    flow = ValueFlow(model_of(definitions, f"{clauses} {rules}"))
    assert [sorted(required(kinds)) for kinds in required(flow.kinds_of_event(functor("e", 2)))] == [
        ["atom", "list"],
        ["number"],
    ]
    assert flow.kinds_of_event(functor("f", 1)) == [None]
    assert flow.kinds_of_event(functor("g", 1)) == [None]
