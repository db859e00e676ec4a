"""Comparison of the engine with the oracle on random rules and streams, and with itself after neutral changes.

The oracle (``test/oracle``) is an independent evaluator; `test_long_runs` compares more cases.
"""

import re
from collections import Counter
from dataclasses import replace
from itertools import cycle
from random import Random
from typing import Any, Dict, List, Tuple
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracle.combination_evaluator import defined_for, firings
from oracle.comparison import answer, difference, engine_events, engine_steps, report, shrink
from oracle.nested_absence_cases import NestedAbsences
from oracle.pattern_classes import Check, Cnot, Fnot, Sub, walk
from oracle.rule_notation import stream, write_rule
from oracle.strategies import cases, drawn_cases

from retalis import atom, functor
from retalis.events.matches import interval_index, match_buffer
from retalis.prolog.terms.timestamps import SECOND, datime, datime6, to_term

quick = settings(max_examples=20, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))


MAX_EVENTS = 16
"""Maximum length of streams under ``unrestricted``: with 25 events, some rules have too many matches."""


def limit_stream(case: Any) -> Any:
    """Return a case whose stream is short enough for its policies."""
    return replace(case, stream=case.stream[:MAX_EVENTS]) if "unrestricted" in case.policies() else case


def events_of_engine(case: Any, texts: Any = None, goals: str = "", events: Any = None) -> Any:
    texts = texts or [case.text()]
    return engine_events(texts, case.goals() + goals, case.stream if events is None else events)


def garbage_control(window: int) -> str:
    return (
        f"set_etalis_flag(garbage_control,general).\nset_etalis_flag(garbage_window,{window}).\n"
        "set_etalis_flag(garbage_window_step,1).\n"
    )


@pytest.mark.slow
@settings(quick, max_examples=50)
@given(cases())
def test_random_rules_equal_oracle(case: Any) -> None:
    case = limit_stream(case)
    if difference(case) is not None:
        pytest.fail(report(shrink(case, lambda smaller: difference(smaller) is not None)), pytrace=False)


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases(unsure=True))
def test_conditions_on_open_variables_equal_oracle(case: Any) -> None:
    assert difference(limit_stream(case)) is None


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases(instants=True))
def test_instants_of_matches_equal_oracle(case: Any) -> None:
    assert difference(limit_stream(case)) is None


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases(overlaps=True))
def test_without_equals_oracle(case: Any) -> None:
    assert difference(limit_stream(case)) is None


@pytest.mark.slow
@settings(quick, max_examples=40)
@given(st.integers(0, 10**9))
def test_retraction_with_nested_absences_equals_oracle(seed: int) -> None:
    assert difference(NestedAbsences(Random(seed).choice, revision=True, overlaps=True).case()) is None


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases(streams=True))
def test_stream_operators_equal_oracle(case: Any) -> None:
    assert difference(limit_stream(case)) is None


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases())
def test_partner_lookup_by_time_equals_oracle(case: Any) -> None:
    limits: Dict[str, Any] = {
        "MAX_MISSES_BEFORE_INDEX": 0,
        "MAX_MISSES_WITH_INDEX": 0,
        "MAX_COMPARED_IDENTITIES": 0,
    }
    with patch.multiple(match_buffer, **limits), patch.object(interval_index, "MAX_NODE_KEYS", 4):
        assert difference(case) is None


@pytest.mark.slow
@quick
@given(drawn_cases())
def test_drawn_rules_equal_oracle(case: Any) -> None:
    assert events_of_engine(case) == answer(case)


@pytest.mark.slow
@quick
@given(cases(depth=3), st.integers(1, 6))
def test_garbage_control_keeps_young_matches(case: Any, window: int) -> None:
    """The results include those without parts older than the window, and no others than without garbage control."""
    case = replace(case, policy="unrestricted")
    assume(defined_for(case.rules) and not case.has_limits())
    rule = case.rules[0]
    assume(not any(isinstance(node, (Cnot, Fnot)) for node in walk(rule.pattern)))
    steps = engine_steps([case.text()], case.goals() + garbage_control(window), case.stream)
    most = firings(rule, case.stream, case.out_of_order)
    least = firings(rule, case.stream, case.out_of_order, youngest=window)
    for derived, maximum, minimum in zip(steps, most, least):
        fired = Counter((term, start / 10**9, end / 10**9) for term, start, end in derived[1:])
        assert minimum - fired == Counter()
        assert fired - maximum == Counter()


@pytest.mark.parametrize(
    "pattern",
    ["a seq b", "a and b", "(a seq c) seq b", "a forall_seq b", "a seq b star_times", "(a or c) seq b"],
)
def test_garbage_control_removes_old_matches(pattern: str) -> None:
    policy = "set_etalis_flag(event_consumption_policy,unrestricted).\n"
    events = stream("a@1 c@2 c@9 c@10 c@11 b@12")
    old = ("out", 10**9, 12 * 10**9)
    assert old in engine_events([f"out <- {pattern}."], policy, events)
    assert old not in engine_events([f"out <- {pattern}."], policy + garbage_control(5), events)


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases(depth=3, revision=True))
def test_revision_equals_oracle(case: Any) -> None:
    if difference(case) is not None:
        pytest.fail(report(shrink(case, lambda smaller: difference(smaller) is not None)), pytrace=False)


@pytest.mark.slow
@quick
@given(cases(), st.integers(1, 10**4))
def test_shifted_stream_has_shifted_results(case: Any, seconds: int) -> None:
    assume(not any(isinstance(node, Check) for rule in case.rules for node in walk(rule.pattern)))
    later = [(term, start + seconds, end + seconds) for term, start, end in case.stream]
    shifted = events_of_engine(case, events=later)
    by = seconds * 10**9
    assert [(term, start - by, end - by) for term, start, end in shifted] == events_of_engine(case)


def in_forms(stream: Any) -> List[Tuple[Any, ...]]:
    """Return a stream whose timestamps have alternating forms."""
    forms = cycle((datime, to_term, datime6))
    return [(term, *(next(forms)(round(stamp * SECOND)) for stamp in interval)) for term, *interval in stream]


def as_numbers(fired: Any) -> List[Tuple[Any, ...]]:
    """Return events with the timestamps in their terms as seconds."""
    stamp = re.compile(r"datime\(1970,1,1,0,(\d+),([\d.]+)(?:,0)?\)")
    return [
        (stamp.sub(lambda match: str(int(match[1]) * 60 + int(float(match[2]))), term), *interval)
        for term, *interval in fired
    ]


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases())
def test_forms_of_timestamps_have_equal_results(case: Any) -> None:
    """Conditions on t1 and t2 have equal results for numbers and datimes."""
    fired = events_of_engine(case, events=in_forms(case.stream))
    assert as_numbers(fired) == [(term, *interval) for term, *interval in events_of_engine(case)]


@pytest.mark.slow
@quick
@given(cases())
def test_renamed_variables_have_equal_results(case: Any) -> None:
    assert events_of_engine(case, [case.text("_Other{}x")]) == events_of_engine(case)


@pytest.mark.slow
@quick
@given(cases(), cases(depth=2))
def test_other_rules_do_not_change_results(case: Any, other: Any) -> None:
    """Rules with other heads, also of the same patterns, do not consume partners of a rule."""
    extra: List[Any] = []
    for number, rule in enumerate((*case.rules, *other.rules)):
        if any(isinstance(node, Sub) for node in walk(rule.pattern)):
            continue  # a sub-pattern defines an event of its own
        arguments = rule.head[1:] if rule.head.__class__ is tuple else ()
        head = functor("elsewhere", len(arguments))(*arguments) if arguments else atom("elsewhere")
        extra.append(write_rule(replace(rule, head=head, label=rule.label and f"other{number}")))
    text = "\n".join([*extra[:1], case.text(), *extra[1:]])
    events = [event for event in events_of_engine(case, [text]) if not event[0].startswith("elsewhere")]
    assert events == events_of_engine(case)


@pytest.mark.slow
@quick
@given(cases())
def test_rules_in_several_files_have_equal_results(case: Any) -> None:
    assert events_of_engine(case, [write_rule(rule) for rule in case.rules]) == events_of_engine(case)


@pytest.mark.slow
@pytest.mark.parametrize(
    "flags",
    [
        "set_etalis_flag(rule_sharing,on).\n",
        "set_etalis_flag(etalis_justification,on).\n",
        "set_etalis_flag(revision_flag,on).\n",
        garbage_control(100_000),
    ],
    ids=["sharing", "justification", "revision", "garbage_control"],
)
@quick
@given(case=cases())
def test_neutral_flags_do_not_change_results(flags: Any, case: Any) -> None:
    assert events_of_engine(case, goals=flags) == events_of_engine(case)
