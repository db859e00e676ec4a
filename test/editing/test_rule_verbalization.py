"""Readings of rules in words."""

from pathlib import Path
from typing import List

import pytest

from retalis.editing.clause_reader import ClauseReader, ParsedClause
from retalis.editing.rule_verbalization import describe_rule, read_program
from retalis.events.language.event_operators import EVENT_OPERATORS, OperatorKind
from retalis.events.language.rule_heads import ALARMS, HEAD_READINGS, SYNCHRONIZED
from retalis.events.language.rule_labels import KNOWN_PROPERTIES, PROPERTY_READINGS
from retalis.events.streams.aggregates import AGGREGATES, AggregateFunction
from retalis.events.streams.rate_operators import RATE_OPERATORS


def reading(text: str) -> List[str]:
    (clause,) = ClauseReader(text, "rules")
    assert isinstance(clause, ParsedClause)
    return describe_rule(clause).split("\n")


def test_conditions_follow_pattern() -> None:
    assert reading("near(A) <- (at(A, X) and at(_, X)) within 5 where A > 1.") == [
        "`near(A)` is emitted when",
        "- `at(A, X)` and `at(_, X)` happened, in any order",
        "- and took less than 5 s",
        "- and goal `A>1` has a solution",
    ]


def test_operands_that_are_patterns_are_nested() -> None:
    assert reading("label : x <- (a or b) seq absent(c, 3).") == [
        "`x` is emitted when",
        "- 3 s passed after **P** ended, with no `c` in between",
        "  - **P**:",
        "    - `a` or `b` happened",
    ]


def test_single_event_happened() -> None:
    assert reading("x <- y(1).") == ["`x` is emitted when", "- `y(1)` happened"]


def test_constant_of_message_has_no_quotes() -> None:
    text = "hot <- reading(L) where L >= pkg__0__T{ERROR}"
    assert "goal `L>=pkg__0__T{ERROR}` has a solution" in reading(f"{text}.")[1]


def test_named_slots_are_written_as_in_program() -> None:
    message = "nav_msgs__0__Odometry{twist: {twist: {linear: {x: V}, angular: {z: 0}}}}"
    assert reading(f"moved(V) <- {message}.")[1] == f"- `{message}` happened"
    assert reading("x <- f(a:1, b:{c:2, d:3}).")[1] == "- `f(a:1, b:{c:2, d:3})` happened"


def test_time_to_live_of_zero_is_never() -> None:
    line = "- label `k`: partial matches and keys are never dropped for their age"
    assert reading("k([property(ttl, 0)]) : x <- y(R) with change(R).")[2] == line


def test_declared_states_have_readings(tmp_path: Path) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text("x <- y.\n:- state(low(R), from(b(R)), until(c), [within(90)]).\nz <- low(_).\n")
    readings = [(item.name, item.line) for item in read_program(str(rules))]
    assert readings == [("x", 1), ("low(R)", 2), ("z", 3)]
    assert list(read_program(str(rules)))[1].text.split("\n") == [
        "`low(R)` holds, and is emitted when it ends,",
        "- from the end of `b(R)`",
        "- until `c`, at most 1 min 30 s",
    ]


def test_rate_has_words_of_its_notation() -> None:
    assert reading("x <- y with debounce(2).")[1] == "- `y` happened, and no other `y` for 2 s after it"


@pytest.mark.parametrize("text", ["a(1).", "p :- q.", ":- dynamic f/1."])
def test_other_clauses_have_no_reading(text: str) -> None:
    assert reading(text) == [""]


def test_long_pattern_is_shortened() -> None:
    lines = reading(f"x <- {' seq '.join(f'(a{number} or b)' for number in range(100))}.")
    assert len(lines) < 40
    assert lines[-1] == "- ..."


def test_durations_have_units() -> None:
    assert reading("x <- a seq absent(b, 5000).")[1] == (
        "- 1 h 23 min 20 s passed after `a` ended, with no `b` in between"
    )
    assert reading("x <- a with not_preceded(b, 90).")[1] == (
        "- `a` happened, and no `b` ended in the 1 min 30 s before `a` started"
    )
    assert reading("x(N) <- n(N) seq absent(b, N).")[1].startswith("- `N` seconds passed")
    assert reading("x(N) <- n(N) seq absent(b, N * 2).")[1].endswith("before `absent(b, N*2)` started")
    assert reading("x(N) <- n(N) seq absent(b, 0.25).")[1].startswith("- 250 ms passed")


def test_window_has_words_of_its_measures() -> None:
    assert reading("x(L, H) <- aggregate([min(T), quantile(0.9, T)], t(T), [L, H], last(90)).")[1] == (
        "- `t(T)` happened; `L` is the smallest `T` and `H` is the quantile `0.9` of `T` in the last 1 min 30 s"
    )
    assert reading("x(R) <- aggregate([count, avg(T)], a(T) or b(T), R, every(60, first)).")[1:] == [
        "- 1 min passed after a first **Q**; `R` is a list with the number of **Q** and the average of `T` in this "
        "time",
        "  - **Q**:",
        "    - `a(T)` or `b(T)` happened",
    ]


def test_held_values_have_words_for_all_notations() -> None:
    text = reading("x(N) <- aggregate(avg(T), a(T), N, held(last(90))).")[1]
    assert text == (
        "- `a(T)` happened; `N` is the average of `T` over time in the last 1 min 30 s, in which each `a(T)` lasts "
        "until the next one"
    )
    for window in ("last(5)", "every(5)", "last(5, every(2))"):
        for limit, words in (("", "next one"), (", max(7)", "next one, at most 7 s")):
            text = reading(f"x(N) <- aggregate(duration(T > 3), a(T), N, held({window}{limit})).")[1]
            assert "`N` is the number of seconds for which `T>3` holds in" in text
            assert text.endswith(words)


def test_sessions_have_words_for_both_notations() -> None:
    assert reading("x(N) <- aggregate(count, a(_), N, session(90)).")[1] == (
        "- no `a(_)` happened for 1 min 30 s; `N` is the number of `a(_)` since the last such pause"
    )
    assert reading("x(N) <- aggregate(count, a(_), N, session(90, max(600))).")[1] == (
        "- no `a(_)` happened for 1 min 30 s, or 10 min passed after the first of them; `N` is the number of `a(_)` "
        "in them"
    )


def test_steps_have_a_line_each() -> None:
    text = "x <- aggregate(count, v(V), _, steps([low, later(high(2, many, until(V < 1))) where V > 3]))."
    assert reading(text)[1:] == [
        "- `v(V)` happened in these steps",
        "  - `low`: once",
        "  - `high`: after any others, 2 times or more, where goal `V>3` has a solution, "
        "until goal `V<1` has a solution",
    ]


def test_groups_of_steps_are_indented() -> None:
    steps = "low, group([a, (b where V > 1) or c], 1, many, reluctant), permute([d, e])"
    text = f"x <- aggregate(count, v(V), _, steps([{steps}]))."
    assert reading(text)[2:] == [
        "  - `low`: once",
        "  - these steps, once or more, as few as possible:",
        "    - `a`: once",
        "    - one of these steps; the first one that fits is preferred:",
        "      - `b`: once, where goal `V>1` has a solution",
        "      - `c`: once",
        "  - these steps in any order:",
        "    - `d`: once",
        "    - `e`: once",
    ]


def test_timed_out_steps_have_words() -> None:
    text = (
        "x(N) <- aggregate(count, v(V), N, timed_out(steps([low, high], [after_match(skip_to_next)]), 90))."
    )
    assert reading(text)[1:] == [
        "- `v(V)` began these steps, and did not complete them within 1 min 30 s; `N` is the number of `v(V)` in "
        "them so far",
        "  - `low`: once",
        "  - `high`: once",
        "  - the next match begins at the event after the first one of a match",
    ]


def test_rows_of_steps_have_names_in_measures() -> None:
    kinds = "[first(t1), of(high, last(t2)), list(step), max(V)]"
    text = f"x(S, R) <- aggregate({kinds}, v(V), [S, E, Names, 9], steps([low(0, 1), high(0, many) where V > 1]))."
    assert reading(text)[1:] == [
        "- `v(V)` happened in these steps; `S` is the first start, `E` is the last end of step `high`, `Names` is "
        "the list of all step names and the largest `V` is `9` in them",
        "  - `low`: at most once",
        "  - `high`: any number of times, where goal `V>1` has a solution",
    ]


def test_instant_of_sequence_has_a_line() -> None:
    assert reading("x <- at_end(a seq b).")[1:] == [
        "- `a` ended before `b` started",
        "- only the instant of its end counts",
    ]


def test_option_of_steps_has_a_line() -> None:
    text = "x <- aggregate(count, v(V), _, steps([low, high], [after_match({})]))."
    assert reading(text.format("skip_to_last(high)"))[-1] == (
        "  - the next match begins at the last event of step `high` in a match"
    )
    assert reading(text.format("skip_to_next"))[-1] == (
        "  - the next match begins at the event after the first one of a match"
    )


def test_repeated_aggregate_has_words_of_its_measure() -> None:
    assert reading("x(M) <- walk seq aggregate(max(D), step(D), M).")[1] == (
        "- `walk` happened, and again at each later `step(D)`; `M` is the largest `D` since `walk`"
    )


def test_operators_right_of_rate_operator_follow_it() -> None:
    assert reading("x <- y(R) with throttle(60, R) where g(R).")[1:] == [
        "- `y(R)` happened, at most once in 1 min for each `R`",
        "- and goal `g(R)` has a solution",
    ]


@pytest.mark.parametrize(
    ("text", "first_line"),
    [
        ("null do g(X) <- b(X).", "goal `g(X)` is called when"),
        ("b(X) do g(X).", "goal `g(X)` is called when"),
        ("h(X) do g <- b(X).", "goal `g` is called, and if it succeeds, `h(X)` is emitted when"),
        ("exceptionAlarm(h, 90) <- b.", "`h` is emitted 1 min 30 s after the end of this match:"),
        ("exceptionAlarmAbsoluteDatime(h, T) <- b(T).", "`h` is emitted at `T`, after this match:"),
        (
            "syncronized(h, g, [[m, T]]) <- b(T).",
            "`h` is emitted if goal `g` has a solution when the data of `[[m, T]]` have arrived, after this match:",
        ),
    ],
)
def test_head_has_words_of_its_form(text: str, first_line: str) -> None:
    assert reading(text)[0] == first_line


def test_properties_of_label_follow_pattern() -> None:
    assert reading("slow([property(window, 90), property(watermark_delay, auto)]) : x <- y.")[2:] == [
        "- label `slow`: a match takes at most 1 min 30 s",
        "- label `slow`: deadlines and windows wait `auto` for late events",
    ]


def test_deep_pattern_is_shortened() -> None:
    conditions = " where g" * 5000
    assert reading(f"x <- y{conditions}.")[1] == "- ..."


def has_own_words(pattern: str) -> bool:
    lines = reading(f"x <- {pattern}.")
    return f"- `{pattern}` happened" not in lines and "as `" not in lines[1]


def test_each_notation_of_operators_has_words() -> None:
    for operator in EVENT_OPERATORS:
        rows = [notation for row in operator.table_rows for notation in row.notation.split("`")[1::2]]
        if operator.kind not in (OperatorKind.RULE, OperatorKind.UNSUPPORTED) and not rows:
            assert operator.readings or operator.name == "fnot", operator.name
        for notation in [*rows, *(row.notation for row in operator.readings)]:
            assert has_own_words(notation), notation


@pytest.mark.parametrize("name", RATE_OPERATORS)
def test_each_rate_operator_has_words(name: str) -> None:
    assert has_own_words(f"y(X, K) with {name}(2)")
    assert has_own_words(f"y(X, K) with {name}(2, K)")


@pytest.mark.parametrize("function", AGGREGATES.values(), ids=lambda function: str(function.name))
def test_each_aggregate_has_words(function: AggregateFunction) -> None:
    line = reading(f"x(R) <- aggregate({function.notation}, y(X), R, last(5)).")[1]
    assert line.startswith("- `y(X)` happened; `R` is the ")
    assert f"`R` is `{function.notation}`" not in line


WINDOWS = [
    "last(5)",
    "last(5, events)",
    "last(6, every(2))",
    "every(5)",
    "every(5, first)",
    "every(5, events)",
]


@pytest.mark.parametrize(
    "window", [*WINDOWS, *(f"running({window})" for window in WINDOWS[3:]), "steps([a])"]
)
def test_each_window_has_words(window: str) -> None:
    assert has_own_words(f"aggregate(count, y, R, {window})")


def test_each_property_has_words() -> None:
    assert sorted(PROPERTY_READINGS) == sorted(KNOWN_PROPERTIES)


def test_each_delayed_head_has_words() -> None:
    named = {notation.partition("(")[0] for notation, _ in HEAD_READINGS}
    assert named == {functor.name for functor in (*ALARMS, *SYNCHRONIZED)}
