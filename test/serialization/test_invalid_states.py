"""States with invalid values and valid checksums."""

import re
import sys
from typing import Any, Dict, List

import pytest
from serialization.field_dictionaries import fields_of, to_fields

from retalis import Engine, StreamClock, UsageError, atom, functor, make_list
from retalis.events.matches.match_types import PartialMatch
from retalis.prolog.terms.timestamps import MAX_TIMESTAMP, SECOND, FloatSeconds, Stamp
from retalis.serialization.codec import Ref, from_bytes, to_bytes
from retalis.serialization.state_file_format import pack_sections, unpack_sections
from retalis.serialization.stored_field_types import invalid_value

RULES = """
p(X, Y) <- a(X) seq b(Y).
w(N) <- aggregate(count, a(_), N, last(10)).
m(L) <- a(_) seq aggregate(list(X), b(X), L).
"""
GOALS = "memorize(a(X), [], X, as, 10)\nsubscribe(p(_, _), [], _, t, s)\ntimer(c(1), after(30))"


@pytest.fixture(scope="module")
def state() -> Dict[str, bytes]:
    engine = Engine(StreamClock())
    engine.load(RULES, GOALS)
    for now, event in enumerate(("a(1)", "a(2)", "b(1)"), 1):
        engine.event(event, now)
    return unpack_sections(engine.snapshot()).sections


def changed(state: Any, section: str, path: Any, value: Any) -> bytes:
    """Return a state with another value at a path of a section."""
    data = from_bytes(state[section])

    def put(old: Any, path: Any) -> Any:
        if not path:
            return value(old) if callable(value) else value
        first, *rest = path
        if isinstance(first, str):
            if isinstance(old[0], list):
                return [[name, put(item, rest)] if name == first else [name, item] for name, item in old]
            position = old[::2].index(first) * 2 + 1
            return [*old[:position], put(old[position], rest), *old[position + 1 :]]
        return [put(item, rest) if index == first else item for index, item in enumerate(old)]

    return pack_sections({**state, section: to_bytes(put(data, path))})


def twice(column: Any) -> Any:
    """Return a column with each value twice; instants are packed."""
    if len(column) == 3 and isinstance(column[1], bytes):
        return [part * 2 for part in column]
    return column * 2


RULE = ["state", "rule_states", 0, 1]
"""Path of the state of the first rule in section ``matches``."""

ARRIVALS = [*RULE, "stored_arrivals"]
NODES = [*RULE, "node_states"]
OPERATOR = [*NODES, 1, 1, "stream"]
"""Path of the state of an operator above a single event."""


def test_unchanged_state_is_restored(state: Dict[str, bytes]) -> None:
    assert Engine.restore(changed(state, "run", ["event_input", "event_count"], 3)).query(
        "memory_size(as, N)"
    ) == [{"N": 10}]


@pytest.mark.parametrize(
    ("section", "path", "value", "message"),
    [
        (
            "run",
            ["event_input", "event_count"],
            "x",
            "section run: event_input: event_count: 'x': expected an integer",
        ),
        ("run", ["event_input", "event_count"], True, "expected an integer"),
        ("run", ["clock"], [1], "clock: '[1]': expected alternating names and values"),
        ("run", ["clock", "newest"], 1 << 100, "clock: newest: '1267650600228229401496703205376': expected"),
        ("run", ["clock", "newest"], 1 << 80, "expected an instant that a clock can reach"),
        ("run", ["subscriptions", "sent_counts"], [], "expected a count of outputs"),
        ("run", [], [], "expected the fields clock_follows_events"),
        ("values", ["flags"], [["double_quotes", atom("x")]], "Prolog flag 'double_quotes'"),
        ("values", ["builtin_state"], [["other", 1]], "a kind of state of built-in predicates"),
        ("program", ["rules", "definitions", 1, "term", 0], atom("x"), "expected an event rule"),
        ("program", ["rules", "definitions", 1, "serial", 0], 7, "expected rules with increasing serials"),
        ("program", ["rules", "definitions", 0], 7, "term: '3': expected 7 values"),
        ("program", ["rules", "flags"], [["no_flag", 1]], "no flag"),
        ("program", ["memories", 1, "definition", 0], atom("x"), "a term of memorize/5"),
        ("program", ["deployments"], [["\0", []]], "expected a path"),
        ("clauses", ["operators"], [[1201, "xfx", "near"]], "expected an integer from 0 to 1200"),
        ("clauses", ["operators"], [[700, "fff", "near"]], "'fff': expected one of "),
        ("matches", ["state", "rule_states"], [], "expected the state of each rule"),
        ("matches", [*ARRIVALS, "matches", 0], 10_000, "expected references to event match or match"),
        ("matches", [*ARRIVALS, "matches", 0], 2, "expected references to event match or match"),
        ("matches", [*ARRIVALS, "matches", 0], Ref(0), "expected an integer"),
        (
            "matches",
            [*ARRIVALS, "buffer_numbers", 0],
            99,
            "with the values and the event that their node requires",
        ),
        (
            "matches",
            [*ARRIVALS, "buffer_numbers", 0],
            -2,
            "buffer_numbers: item 0: '-2': expected an integer from -1",
        ),
        ("matches", [*ARRIVALS, "orders", 0], 10**20, "distinct orders that have been assigned"),
        ("matches", [*ARRIVALS, "orders"], [], "expected a buffer and an order for each partial match"),
        (
            "matches",
            ARRIVALS,
            lambda old: to_fields({name: column + column for name, column in fields_of(old).items()}),
            "partial matches with distinct orders",
        ),
        (
            "matches",
            ARRIVALS,
            lambda old: to_fields(
                {
                    name: column + ([0] if name == "orders" else column)
                    for name, column in fields_of(old).items()
                }
            ),
            "partial matches that are stored once",
        ),
        ("matches", [*NODES, 0, 0], "Leaves", "its nodes differ from those in the state"),
        ("matches", ["objects", 1], b"\x63", "expected codes of kinds"),
        ("matches", ["objects", 1], b"", "objects: '1': expected 0 objects of kind node"),
        ("matches", ["objects", 0], ["run cursor"], "expected codes of kinds"),
        ("matches", ["objects", 2], [], "expected the kinds event match"),
        ("matches", ["objects", 2, "match"], [], "match: '[]': expected the fields values, start"),
        ("matches", ["objects", 2, "match", "values"], [[1]], "match: values: '1': expected 2 values"),
        (
            "matches",
            ["objects", 2, "match", "values", 0],
            [],
            "run: expected the values that its node requires",
        ),
        ("matches", ["objects", 2, "match", "start", 0], b"", "expected 2 instants"),
        ("matches", ["objects", 2, "match", "start"], None, "match: start: 'None': expected an instant"),
        (
            "matches",
            ["objects", 2, "match", "parts"],
            [[5], None],
            "object 5, of kind match, contains itself",
        ),
        ("matches", ["objects", 2, "match", "parts"], [[None], None], "expected a sequence"),
        ("matches", ["objects", 2, "match", "term"], None, "run: expected the values that its node requires"),
        (
            "matches",
            ["objects", 2, "match", "consumed_by"],
            [5000, None],
            "expected references to event match",
        ),
        ("matches", ["objects", 2, "run", "first"], None, "run: first: 'None': expected a reference"),
        ("matches", ["objects", 2, "run", "last"], None, "run: last: 'None': expected an instant"),
        (
            "matches",
            ["objects", 2, "run", "state"],
            ["x", []],
            "run: state: item 0: 'x': expected a sequence",
        ),
        ("matches", ["objects", 2, "run", "node"], [0], "run: node: '[0]': expected references to node"),
        (
            "matches",
            ["state", "timers", "stored_timers"],
            lambda old: [
                2,
                to_fields({name: twice(column) for name, column in fields_of(old[1]).items()}),
            ],
            "alarms with distinct orders",
        ),
        (
            "matches",
            ["state", "timers", "stored_timers", 1, "schedule", 0],
            functor("no", 1)(1),
            "expected every",
        ),
        (
            "matches",
            ["state", "pending_queries", "stored_queries"],
            [
                1,
                to_fields(
                    {
                        "order": [0],
                        "event": [atom("x")],
                        "query": [atom("y")],
                        "start": [bytes(8), b"\0", []],
                        "end": [bytes(8), b"\0", []],
                        "awaited": [[]],
                        "cause": [None],
                    }
                ),
            ],
            "awaited: item 0: '[]': expected at least 1 items",
        ),
        ("memory 0", ["terms", 1], [None, None], "terms: item 0: 'None': expected a term"),
        ("memory 0", ["terms", 1], [], "expected 2 terms"),
        ("memory 0", ["terms"], ["floats", bytes(8)], "expected 2 terms"),
        ("memory 0", ["terms"], ["columns", functor("a", 1), []], "expected 2 terms"),
        ("memory 0", ["terms"], ["columns", functor("a", 1), [["terms", [1, []]]]], "expected a term"),
        ("memory 0", ["terms"], ["indexed", [1], b"\0\0\0"], "expected 2 terms"),
        ("memory 0", ["terms"], ["indexed", [1], b"\0\1"], "'1': expected a position among 1 terms"),
        ("memory 0", ["terms"], ["indexed", [[]], bytes(2)], "expected a term"),
        ("memory 0", ["terms"], ["indexed", [1] * 257, bytes(3)], "expected positions of 2 bytes"),
        ("memory 0", ["terms"], ["parts", []], "expected 2 terms"),
        ("memory 0", ["terms"], ["parts", [["parts", [["terms", [1, 2]]]]]], "expected 2 terms"),
        ("memory 0", ["ends", 0], b"", "expected 2 instants"),
        ("memory 0", ["ends", 1], b"\x07\0", "the forms of instants"),
        ("memory 0", ["ends", 0], [9, 3], "not ordered by their ends"),
    ],
)
def test_invalid_value_is_refused(
    state: Dict[str, bytes], section: str, path: Any, value: Any, message: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        Engine.restore(changed(state, section, path, value))


def test_element_of_two_operators_is_refused() -> None:
    engine = Engine(StreamClock())
    engine.load("v(N) <- aggregate(count, a(_), N, last(10)).\nw(N) <- aggregate(count, a(_), N, last(20)).")
    engine.event("a(1)", 1)
    state = unpack_sections(engine.snapshot()).sections
    rule_states = ["state", "rule_states"]
    window = ["node_states", 1, 1, "stream", "keyed_windows", 1, "elements"]
    elements: List[Any] = []

    def record(old: Any) -> Any:
        elements.append(old)
        return old

    changed(state, "matches", [*rule_states, 0, 1, *window], record)
    assert Engine.restore(changed(state, "matches", [*rule_states, 0, 1, *window], elements[0])).snapshot()
    with pytest.raises(UsageError, match="StreamElement: expected an object of one owner"):
        Engine.restore(changed(state, "matches", [*rule_states, 1, 1, *window], elements[0]))


@pytest.mark.parametrize("missing", ["program", "clauses", "values", "matches", "run", "memory 0"])
def test_missing_section_is_refused(state: Dict[str, bytes], missing: str) -> None:
    with pytest.raises(UsageError, match="no section|expected records for each memory"):
        Engine.restore(pack_sections({name: data for name, data in state.items() if name != missing}))


def test_unknown_section_is_refused(state: Dict[str, bytes]) -> None:
    with pytest.raises(UsageError, match="section 'more' is unknown"):
        Engine.restore(pack_sections({**state, "more": to_bytes(1)}))


@pytest.mark.parametrize(
    ("number", "problem"), [(5, "format 5, a pickle .* never read"), (7, "the state is of format 7")]
)
def test_other_format_is_refused(state: Dict[str, bytes], number: int, problem: str) -> None:
    data = pack_sections(state).replace(b'"format": 14', b'"format":  %d' % number)
    with pytest.raises(UsageError, match=f"{problem}: this version reads formats 11 to 14"):
        Engine.restore(data)


def test_changed_operators_are_restored() -> None:
    engine = Engine(StreamClock())
    engine.load(goals="op(700, xfx, near)\nop(0, yfx, mod)\nop(200, xfx, is)")
    restored = Engine.restore(engine.snapshot())
    assert list(restored.logic.operators) == list(engine.logic.operators)
    assert len(list(restored.logic.operators)) == len(list(Engine().logic.operators))


def test_records_are_restored_from_columns() -> None:
    engine = Engine(StreamClock())
    engine.load(goals="memorize(tf(_, _, _, _), [], _, m, 200)")
    for number in range(150):
        engine.event(
            f'tf(a{number % 3}, v({number}.5, {number / 7!r}), x(y({number}), [{number}]), "s")', number + 1
        )
    restored = Engine.restore(engine.snapshot())
    query = "access_mem(m, R, I)"
    assert [str(solution) for solution in restored.query(query)] == [
        str(solution) for solution in engine.query(query)
    ]
    assert len(restored.query(query)) == 150


SHARED = functor("s", 1)(1)
LONG = make_list(range(100))


@pytest.mark.slow
@pytest.mark.parametrize("number", [49, 50, 203, 1000, 1001, 2500])
@pytest.mark.parametrize(
    "value",
    [
        lambda at: at / 7,
        lambda at: at,
        lambda at: at if at % 40 else 2**70,
        lambda at: at / 7 if at % 40 else 1,
        lambda at: at / 7 if at % 40 or not at else atom("none"),
        lambda at: atom(f"a{at % 3}"),
        lambda at: atom(f"a{at % 256}"),
        lambda at: atom(f"a{at % 257}"),
        lambda at: atom(f"a{at}") if at % 40 or not at else LONG,
        lambda at: SHARED if at % 40 else 1.5,
        lambda at: functor("q", 2)(at, SHARED) if at % 40 else functor("r", 1)(at),
        lambda at: functor("q", 2)(at / 3, functor("u", 1)(at)) if at % 40 or not at else atom("none"),
    ],
)
def test_arguments_of_all_kinds_are_restored(number: int, value: Any) -> None:
    engine = Engine(StreamClock())
    engine.load(goals=f"memorize(f(_, _), [], _, m, {number})")
    for index in range(number):
        engine.event_at(functor("f", 2)(value(index), functor("g", 1)(value(index))), index, index)
    restored = Engine.restore(engine.snapshot())
    query = "access_mem(m, R, I)"
    assert [str(solution) for solution in restored.query(query)] == [
        str(solution) for solution in engine.query(query)
    ]
    assert len(restored.query(query)) == number


def test_instants_in_records_are_restored_as_integers() -> None:
    engine = Engine(StreamClock())
    engine.load(goals="memorize(f(_, _), [], _, m, 60)")
    for number in range(60):
        stamp = Stamp.of(number, functor("s", 1)(number))
        engine.event_at(
            functor("f", 2)(FloatSeconds(number), stamp if number % 7 else number), number, number
        )
    restored = Engine.restore(engine.snapshot())
    records = [solution["R"] for solution in restored.query("access_mem(m, R, _)")]
    assert records == [functor("f", 2)(number, number) for number in reversed(range(60))]


def without_scanning(data: Any) -> Any:
    """Return data without the computation states that wait for the first element of a row pattern."""
    if not isinstance(data, list):
        return data
    if "step" in str(data)[:20] and isinstance(data[0], int):
        row_count, columns = data
        kept = [index for index, step in enumerate(columns[1]) if step != -1]
        columns = {name: [column[index] for index in kept] for name, column in fields_of(columns).items()}
        return [len(kept), to_fields(columns)]
    return [without_scanning(item) for item in data]


def test_row_pattern_without_initial_state_is_refused() -> None:
    engine = Engine(StreamClock())
    engine.load("s(N) <- aggregate(count, v(X), N, steps([up where X > 3, down(2) where X < 3])).")
    engine.event("v(5)", 1)
    state = unpack_sections(engine.snapshot()).sections
    data = from_bytes(state["matches"])
    assert without_scanning(data) != data
    Engine.restore(pack_sections(state)).event("v(1)", 2)
    with pytest.raises(UsageError, match="valid computation states of a row pattern"):
        Engine.restore(pack_sections({**state, "matches": to_bytes(without_scanning(data))}))


def test_state_after_largest_timestamp_is_restored() -> None:
    engine = Engine()
    engine.event("a(1)", MAX_TIMESTAMP // SECOND)
    for number in range(3):
        engine.event(f"b({number})")
    assert Engine.restore(engine.snapshot()).clock.now() == engine.clock.now()


@pytest.mark.parametrize("stamp", [MAX_TIMESTAMP // SECOND + 1, -(1 << 100), 1e30, make_list([10**16, 0])])
def test_timestamp_out_of_range_is_refused(stamp: Any) -> None:
    engine = Engine()
    with pytest.raises(UsageError, match=r"a timestamp lies at most 6\.0e\+14 s from the epoch"):
        engine.event("a(1)", stamp)


def test_partial_match_of_two_rules_is_refused() -> None:
    engine = Engine()
    engine.load(rules="p(X) <- a(X) seq b(X).\nq(X) <- a(X) seq c(X).\n")
    engine.event("a(1)", 1)
    state = unpack_sections(engine.snapshot()).sections
    states = fields_of(fields_of(from_bytes(state["matches"]))["state"])["rule_states"]
    matches = fields_of(fields_of(states[0][1])["stored_arrivals"])["matches"]
    path = ["state", "rule_states", 1, 1, "stored_arrivals", "matches"]
    with pytest.raises(UsageError, match="partial matches that are stored once"):
        Engine.restore(changed(state, "matches", path, matches))


def state_of(rules: str, events: List[str], goals: str = "") -> Dict[str, bytes]:
    """Return the sections of an engine with rules that has processed one event per second."""
    engine = Engine(StreamClock())
    engine.load(rules, goals)
    for now, event in enumerate(events, 1):
        engine.event(event, now)
    return unpack_sections(engine.snapshot()).sections


def columns(state: Any, kind: str) -> Any:
    """Return the columns of the objects of a kind by name; None if there are none."""
    kinds = dict(fields_of(from_bytes(state["matches"]))["objects"][2])
    return fields_of(kinds[kind]) if kind in kinds else None


def assert_refused(state: Any, path: Any, value: Any, message: str) -> None:
    Engine.restore(pack_sections(state))
    with pytest.raises(UsageError, match=message):
        Engine.restore(changed(state, "matches", path, value))


OTHER_EVENT = functor("other", 1)(2)
MISFIT = (
    "expected (runs of its node|the values that its node requires|a compound term|an event or parts|"
    "an element with a match of its pattern|partial matches with the values and the event)"
)
"""Errors of matches that do not fit their nodes."""


@pytest.mark.parametrize(
    ("attribute", "value"),
    [("values", []), ("values", [1, 2]), ("term", 3), ("term", OTHER_EVENT), ("term", None)],
    ids=lambda value: str(value),
)
@pytest.mark.parametrize(
    "rule",
    [
        "p(X, Y) <- a(X) seq b(Y).",
        "p(X) <- a(X) seq absent(b(_), 2).",
        "p(L) <- a(X) seq (b(_) star_times).",
        "p(X) <- (a(X) and b(_)).",
        "p(X) <- (a(X) with debounce(5)).",
        "p(X) <- (a(X) ntimes 3).",
    ],
)
def test_match_that_does_not_fit_its_node_is_refused(rule: str, attribute: str, value: Any) -> None:
    state = state_of(rule, ["a(1)"])
    kind, column = "match", attribute
    if columns(state, kind) is None:
        # The values of this match are the arguments of its event.
        kind, column = "event match", "term"
        value = functor("a", len(value) or 3)(*(value or [1, 2, 3])) if attribute == "values" else value
    assert_refused(state, ["objects", 2, kind, column, 0], value, MISFIT)


def test_wrong_number_of_repetitions_is_refused() -> None:
    state = state_of(
        "p(X) <- (a(X, _) ntimes 4).",
        ["a(1, 1)", "a(1, 2)", "a(1, 3)"],
        "set_etalis_flag(event_consumption_policy, unrestricted)",
    )
    parts = columns(state, "match")["parts"]
    longest = max(index for index, numbers in enumerate(parts) if numbers is not None and len(numbers) > 1)
    assert_refused(state, ["objects", 2, "match", "parts", longest], parts[longest][:1], "expected")


def test_shared_repetitions_are_restored() -> None:
    engine = Engine(StreamClock())
    engine.load("p(X) <- (a(X, _) ntimes 5).")
    for now, value in (
        (1, 1),
        (2, 2),
        (2, 3),
        (3, 4),
        (3, 5),
        (4, 6),
        (5, 7),
        (5, 8),
        (6, 9),
        (6, 2),
        (7, 3),
    ):
        engine.event(f"a(1, {value})", now)
        restored = Engine.restore(engine.snapshot())
        assert restored.status().rules == engine.status().rules


@pytest.mark.parametrize(
    ("window", "due"),
    [("last(3, events)", 64), ("last(5)", -(1 << 62)), ("every(3, events)", 0)],
)
def test_deadline_of_window_without_one_is_refused(window: str, due: int) -> None:
    state = state_of(f"p(N) <- aggregate(count, a(_), N, {window}).", ["a(1)"])
    assert_refused(state, [*OPERATOR, "next_deadline"], due, "expected nothing")


@pytest.mark.parametrize("due", [None, 0, 1, 4 * SECOND + 1, -(1 << 62)])
def test_wrong_end_of_next_window_is_refused(due: Any) -> None:
    state = state_of("p(N) <- aggregate(count, a(_), N, last(4, every(2))).", ["a(1)", "a(2)", "a(3)"])
    assert_refused(
        state, [*OPERATOR, "next_deadline"], due, "expected the end of the next window|expected an instant"
    )


def test_deadline_of_anchored_window_is_computed() -> None:
    engine = Engine()
    engine.load("p(N) <- aggregate(count, a(_), N, every(5, first)).")
    engine.event("a(1)", 1)
    state = unpack_sections(engine.snapshot()).sections
    engine = Engine.restore(changed(state, "matches", [*OPERATOR, "next_deadline"], None))
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(term))
    engine.event("b(1)", 10)
    assert functor("p", 1)(1) in events


def test_invalid_suppressed_match_is_refused() -> None:
    state = state_of(
        "p(X, Y) <- (a(X) seq c(Y)) cnot b(_).",
        ["a(1)", "b(2)", "c(3)"],
        "set_etalis_flag(revision_flag, on)",
    )
    match = columns(state, "suppressed")["match_or_pair"][0][0]
    path = ["objects", 2, "suppressed", "match_or_pair", 0]
    assert_refused(state, path, match, "expected a suppressed match that its node can try again")
    assert_refused(state, path, [match, match], "expected a suppressed match that its node can try again")


@pytest.mark.parametrize(
    "header", ["{}".encode("utf-16"), b"\x00\xf2", b"\xff", '{"a": 1}'.encode("utf-32-be")]
)
def test_header_in_other_encoding_is_refused(header: bytes) -> None:
    imported = set(sys.modules)
    with pytest.raises(UsageError, match="its header is malformed"):
        unpack_sections(b"retalis state\n%d\n%s" % (len(header), header))
    assert set(sys.modules) == imported


def test_header_with_long_number_is_refused() -> None:
    header = b'{"format": %s}' % (b"9" * 4000)
    with pytest.raises(UsageError, match="its header is malformed"):
        unpack_sections(b"retalis state\n%d\n%s" % (len(header), header))


def test_output_without_elements_is_refused() -> None:
    # A retraction runs the operator again, and identifies its outputs by their last elements.
    state = state_of(
        "p(N) <- aggregate(count, a(_), N, last(2, events)).",
        ["a(1)", "a(2)"],
        "set_etalis_flag(revision_flag, on)",
    )
    outputs = [*NODES, 1, 1, "replay", "stored_outputs", 1]
    assert_refused(state, [*outputs, "elements", 0], [], "elements: item 0: '.*': expected at least 1 items")
    assert_refused(state, outputs, [], "expected the fields elements, start")


def test_object_in_place_of_value_is_named_in_words() -> None:
    match = PartialMatch((), 0, 0, 1, atom("a"), None)
    error = invalid_value([match, (match, 2)], "an atom")
    assert error.message == "'[partial match, (partial match, 2)]': expected an atom"
