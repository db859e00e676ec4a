"""Each operator with each policy in each context: a stream for which its rule fires, and one without results."""

from functools import partial
from typing import Any, Iterator, List, Tuple

import pytest
from events import operator_table

from retalis import Engine, Operators, StreamClock, atom, explain
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.timestamps import SECOND

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")
PARTNER = ("z", 0, 0.2)


class DerivingEngine(Engine):
    """An engine that records derived events, each as text with its start and end in seconds."""

    def __init__(self) -> None:
        super().__init__(clock=StreamClock(1000 * SECOND))
        self._derived: List[Tuple[str, float, float]] = []
        self.on_event(self._record)

    def record_anew(self) -> List[Tuple[str, float, float]]:
        """Return a new list, to which events are added until the next call."""
        self._derived = []
        return self._derived

    def _record(self, term: Any, start: Any, end: Any) -> None:
        text = self.show(term)
        if text.startswith(("out", "rev")):
            self._derived.append((text, int(start) / SECOND, int(end) / SECOND))


class ProgramRun:
    """A program executed on a stream, by an engine whose former programs are removed.

    Attributes:
        engine: The engine.
        derived: Derived events, each as text with its start and end in seconds.
    """

    def __init__(self, engine: Any, rules: Any, stream: Any, policy: Any, **flags: Any) -> None:
        self.engine = engine
        self.engine.rules.reset()
        self.derived = engine.record_anew()
        self._flag("event_consumption_policy", policy)
        for name, value in flags.items():
            self._flag(name, value)
        self.engine.load(rules=rules)
        for event in stream:
            self.take(*event)

    def _flag(self, name: str, value: Any) -> None:
        self.engine.rules.flags.set(name, atom(value) if isinstance(value, str) else value)

    def take(self, text: str, start: int, end: int) -> None:
        self.engine.event(text, start, end)

    @property
    def intervals(self) -> List[Tuple[Any, ...]]:
        return [(start, end) for text, start, end in self.derived if text == "out(1)"]


@pytest.fixture(scope="module")
def run() -> Any:
    """Return a function that runs a program; all runs share the engine, whose creation takes longer than most."""
    return partial(ProgramRun, DerivingEngine())


NIGHTLY_POLICIES = ("recent_2", "chronological", "chronological_2")
"""Policies that differ from others only for competing partners, which these streams do not have."""


def cells(nightly: Any = ()) -> Iterator[Any]:
    for name in operator_table.ROWS:
        for policy in POLICIES:
            marks = [pytest.mark.nightly] if policy in nightly else []
            yield pytest.param(operator_table.ROWS[name], policy, id=f"{name}-{policy}", marks=marks)


each_cell = pytest.mark.parametrize(("row", "policy"), list(cells()))
each_cell_in_context = pytest.mark.parametrize(("row", "policy"), list(cells(NIGHTLY_POLICIES)))


@each_cell
def test_operator_fires_by_its_definition(run: Any, row: Any, policy: Any) -> None:
    rule = f"out(X) <- {row.pattern}."
    assert run(rule, row.fires, policy).intervals == list(row.results)
    assert run(rule, row.never, policy).intervals == []


def nested(row: Any, policy: Any) -> Any:
    """Return the results that are joined with z, which the first of them consumes."""
    results = [(PARTNER[1], end) for _, end in row.results]
    return results if policy == "unrestricted" else results[:1]


@pytest.mark.slow
@each_cell_in_context
@pytest.mark.parametrize("side", ["({}) and z", "z seq ({})"])
def test_operator_is_side_of_another(run: Any, row: Any, policy: str, side: str) -> None:
    rule = f"out(X) <- {side.format(row.pattern)}."
    assert run(rule, (PARTNER, *row.fires), policy).intervals == nested(row, policy)
    assert run(rule, (PARTNER, *row.never), policy).intervals == []
    assert run(rule, row.fires, policy).intervals == []


@pytest.mark.slow
@each_cell_in_context
def test_condition_rejects_results(run: Any, row: Any, policy: Any) -> None:
    assert run(f"out(X) <- ({row.pattern}) where X =:= 1.", row.fires, policy).intervals == list(row.results)
    assert run(f"out(X) <- ({row.pattern}) where X =:= 1.", row.never, policy).intervals == []
    assert run(f"out(X) <- ({row.pattern}) where X =\\= 1.", row.fires, policy).intervals == []


@pytest.mark.slow
@each_cell_in_context
def test_within_excludes_equal_duration(run: Any, row: Any, policy: Any) -> None:
    """The duration must be less than the limit."""
    longest = max(end - start for start, end in row.results)
    assert run(f"out(X) <- ({row.pattern}) within {longest + 0.001}.", row.fires, policy).intervals == list(
        row.results
    )
    shorter = [(start, end) for start, end in row.results if end - start < longest]
    assert run(f"out(X) <- ({row.pattern}) within {longest}.", row.fires, policy).intervals == shorter


@pytest.mark.slow
@each_cell_in_context
def test_window_includes_equal_duration(run: Any, row: Any, policy: Any) -> None:
    """The duration may equal the window; each of both names of the property is tested once."""
    longest = max(end - start for start, end in row.results)
    rule = "r([property({},{})]) : out(X) <- {}."
    assert run(rule.format("window", longest, row.pattern), row.fires, policy).intervals == list(row.results)
    shorter = [(start, end) for start, end in row.results if end - start <= longest - 0.001]
    assert (
        run(rule.format("event_rule_window", longest - 0.001, row.pattern), row.fires, policy).intervals
        == shorter
    )


@pytest.mark.slow
@each_cell_in_context
def test_labelled_rule_is_deleted(run: Any, row: Any, policy: Any) -> None:
    rule = f"r : out(X) <- {row.pattern}."
    assert run(rule, row.fires, policy).intervals == list(row.results)
    assert run(rule, row.never, policy).intervals == []
    for label, remaining in (("other", list(row.results)), ("r", [])):
        result = run(rule, (), policy)
        result.engine.call(f"del_event_rule({label})")
        for event in row.fires:
            result.take(*event)
        assert result.intervals == remaining


@pytest.mark.slow
@each_cell_in_context
def test_late_event_matches_with_out_of_order(run: Any, row: Any, policy: Any) -> None:
    rule = f"out(X) <- {row.pattern}."
    assert run(rule, row.fires, policy, out_of_order="on").intervals == list(row.results)
    assert run(rule, row.never, policy, out_of_order="on").intervals == []
    if row.late:
        assert run(rule, row.late, policy, out_of_order="on").intervals == list(row.results)
        in_order = list(row.results) if row.either else []
        assert run(rule, row.late, policy, out_of_order="off").intervals == in_order


@pytest.mark.slow
@each_cell_in_context
def test_late_result_matches_with_out_of_order(run: Any, row: Any, policy: Any) -> None:
    """Results of an operator are late for z, and match it only if the flag is set."""
    rule = f"out(X) <- ({row.pattern}) seq z."
    stream = (("z", 90, 91), *row.fires)
    # z moves the clock of the rule.
    late_results = [] if row.expires else [(start, 91) for start, _ in row.results]
    results = run(rule, stream, policy, out_of_order="on").intervals
    assert results == (late_results if policy == "unrestricted" else late_results[:1])
    assert run(rule, (("z", 90, 91), *row.never), policy, out_of_order="on").intervals == []
    assert run(rule, stream, policy, out_of_order="off").intervals == []


@pytest.mark.slow
@each_cell_in_context
def test_retraction_retracts_results(run: Any, row: Any, policy: Any) -> None:
    rule = f"out(X) <- {row.pattern}."
    first_event = row.fires[0]
    retractions = [(f"rev({first_event[0]})", 50, 50)] + [("rev(out(1))", 50, 50)] * row.derived
    result = run(rule, row.fires, policy, revision_flag="on")
    assert result.intervals == list(row.results)
    result.derived.clear()
    result.take("rev(nothing)", 49, 49)
    assert result.derived == [("rev(nothing)", 49, 49)]
    result.take(f"rev({first_event[0]})", 50, 50)
    assert [event for event in result.derived[1:] if event[0] != "rev(s(1))"] == retractions
    result.derived.clear()
    result.take(f"rev({first_event[0]})", 51, 51)
    assert result.derived == [(f"rev({first_event[0]})", 51, 51)]
    assert run(rule, row.never, policy, revision_flag="on").intervals == []
    off = run(rule, (*row.fires, (f"rev({first_event[0]})", 50, 50)), policy)
    assert ("rev(out(1))", 50, 50) not in off.derived


@pytest.mark.slow
@each_cell_in_context
def test_justification_explains_results(run: Any, row: Any, policy: Any) -> None:
    rule = f"out(X) <- {row.pattern}."
    result = run(rule, row.fires, policy, etalis_justification="on")
    assert result.intervals == list(row.results)
    event_term = read_term("out(1)", Operators.prolog()).term
    answer = explain(result.engine, event_term)
    assert answer.happened
    assert len(answer.lines) == len(row.results)
    explanation = "\n".join(answer.lines[0].indented())
    assert row.fires[0][0] in explanation
    never = run(rule, row.never, policy, etalis_justification="on")
    assert never.intervals == []
    assert not explain(never.engine, event_term).happened
    assert not explain(run(rule, row.fires, policy).engine, event_term).happened


@pytest.mark.slow
@each_cell_in_context
def test_garbage_control_removes_old_matches(run: Any, row: Any, policy: Any) -> None:
    """An event with a much later timestamp precedes the last event of the stream."""
    rule = f"out(X) <- {row.pattern}."
    stream = (*row.fires[:-1], (row.tick, 500, 501), row.fires[-1])
    control = {"garbage_control": "general", "garbage_window": 100, "garbage_window_step": 1}
    assert run(rule, row.fires, policy, **control).intervals == list(row.results)
    assert run(rule, row.never, policy, **control).intervals == []
    remaining = list(row.results[:-1]) if row.waits else list(row.results)
    assert run(rule, stream, policy).intervals == (remaining if row.expires else list(row.results))
    assert run(rule, stream, policy, **control).intervals == remaining
    pattern = f"r([property(window,100),property(window_step,1)]) : {rule}"
    assert run(pattern, row.fires, policy, garbage_control="pattern").intervals == list(row.results)
    assert run(pattern, stream, policy, garbage_control="pattern").intervals == remaining


@pytest.mark.slow
@each_cell_in_context
def test_garbage_control_removes_old_results(run: Any, row: Any, policy: Any) -> None:
    """Results of an operator wait for z and y, and are removed."""
    rule = f"out(X) <- ({row.pattern}) and (z seq y)."
    stream = (*row.fires, ("z", 500, 501), ("y", 502, 503))
    control = {"garbage_control": "general", "garbage_window": 100, "garbage_window_step": 1}
    assert run(rule, stream, policy).intervals != []
    assert run(rule, stream, policy, **control).intervals == []


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("operator", ["cnot", "fnot"])
def test_garbage_control_removes_negated_events(run: Any, operator: str, policy: str) -> None:
    rule = f"out(X) <- a(X) {operator} c(X)."
    stream = (("c(1)", 1, 2), ("a(9)", 500, 501), ("a(1)", 502, 503))
    control = {"garbage_control": "general", "garbage_window": 100, "garbage_window_step": 1}
    assert run(rule, stream, policy).intervals == []
    assert run(rule, stream, policy, **control).intervals == [(502, 503)]


@pytest.mark.slow
@each_cell_in_context
def test_flags_and_window_do_not_interfere(run: Any, row: Any, policy: Any) -> None:
    """Flags, label, window and condition together do not change the results."""
    longest = max(end - start for start, end in row.results)
    rule = f"r([property(window,{longest})]) : out(X) <- ({row.pattern}) where X =:= 1."
    flags = {
        "out_of_order": "on",
        "revision_flag": "on",
        "etalis_justification": "on",
        "rule_sharing": "on",
        "garbage_control": "general",
        "garbage_window": 1000,
        "garbage_window_step": 1,
    }
    assert run(rule, row.fires, policy, **flags).intervals == list(row.results)
    assert run(rule, row.never, policy, **flags).intervals == []


# ---- competing partners ---------------------------------------------------------------------------


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("operator", operator_table.CONTESTS)
def test_policy_selects_partners(run: Any, operator: Any, policy: str) -> None:
    firsts, seconds, with_first = operator_table.CONTESTS[operator]
    stream = [(f"a({name})", *interval) for name, interval in zip((1, 2, 1), firsts)]
    stream += [(f"b({name})", *interval) for name, interval in zip((1, 2, 3), seconds)]
    expected: List[Any] = []
    for first, second in operator_table.TAKEN[policy]:
        start = firsts[first - 1][0] if with_first else seconds[second - 1][0]
        expected.append((f"out({(1, 2, 1)[first - 1]},{second})", start, seconds[second - 1][1]))
    assert run(f"out(X,Y) <- a(X) {operator} b(Y).", stream, policy).derived == expected


@pytest.mark.parametrize("policy", POLICIES)
def test_forall_seq_consumes_all_partners(run: Any, policy: str) -> None:
    stream = [("a(1)", 1, 1), ("a(2)", 2, 2), ("a(1)", 3, 3), ("b(1)", 4, 4), ("b(2)", 5, 5)]
    derived = run("out(X,Y) <- a(X) forall_seq b(Y).", stream, policy).derived
    assert derived == [("out(1,1)", 1, 4), ("out(2,1)", 2, 4), ("out(1,1)", 3, 4)]


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("pattern", ["b star_times", "aggregate(list(Y), b(Y), _)"])
def test_policy_selects_extended_runs(run: Any, pattern: str, policy: str) -> None:
    event = "b" if pattern.startswith("b") else "b(7)"
    starts = (("a(1)", 1, 2), ("a(2)", 2, 3), ("a(1)", 3, 4))
    stream = [*starts, (event, 5, 6), (event, 7, 8)]
    expected = [(f"out({text[2]})", start, end) for text, start, end in starts]
    for end in (6, 8):
        for number in operator_table.EXTENDED[policy]:
            text, start, _ = starts[number - 1]
            expected.append((f"out({text[2]})", start, end))
    assert run(f"out(X) <- a(X) seq ({pattern}).", stream, policy).derived == expected


@pytest.mark.parametrize("policy", POLICIES)
def test_negated_event_excludes_all_partial_matches(run: Any, policy: str) -> None:
    stream = [("a(1)", 1, 1), ("a(2)", 2, 2), ("c", 3, 3), ("a(3)", 4, 4), ("b", 5, 5)]
    assert run("out(X) <- (a(X) seq b) cnot c.", stream, policy).derived == [("out(3)", 4, 5)]
