"""The engine against the oracle on random rules and streams, and against itself where nothing may change.

The oracle (``test/oracle``) is an evaluator of its own; `test_long_runs` compares more cases.
"""

import re
from collections import Counter
from dataclasses import replace
from itertools import cycle
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracle.comparison import answer, difference, engine_events, engine_steps, report, shrink
from oracle.event_combinations import defined_for, firings
from oracle.patterns import Check, Cnot, Fnot, Sub, walk
from oracle.rule_notation import stream, write_rule
from oracle.strategies import cases, drawn_cases

from retalis import atom, functor
from retalis.events.matches import interval_index, match_buffer
from retalis.prolog.terms.timestamps import SECOND, datime, datime6, to_term

quick = settings(max_examples=20, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))


MOST = 16
"""Events of a stream under a policy that keeps all combinations: of 25 some rules make too many."""


def affordable(case):
    """Return a case with a stream that is worked off in a moment."""
    return replace(case, stream=case.stream[:MOST]) if "unrestricted" in case.policies() else case


def of_engine(case, texts=None, goals="", events=None):
    texts = texts or [case.text()]
    return engine_events(texts, case.goals() + goals, case.stream if events is None else events)


def garbage_control(window):
    return (
        f"set_etalis_flag(garbage_control,general).\nset_etalis_flag(garbage_window,{window}).\n"
        "set_etalis_flag(garbage_window_step,1).\n"
    )


@pytest.mark.slow
@settings(quick, max_examples=100)
@given(cases())
def test_oracle(case):
    case = affordable(case)
    if difference(case) is not None:
        pytest.fail(report(shrink(case, lambda smaller: difference(smaller) is not None)), pytrace=False)


@pytest.mark.slow
@settings(quick, max_examples=30)
@given(cases(unsure=True))
def test_oracle_with_conditions_over_what_may_be_open(case):
    assert difference(affordable(case)) is None


@pytest.mark.slow
@settings(quick, max_examples=30)
@given(cases(streams=True))
def test_oracle_with_operators_on_streams(case):
    assert difference(affordable(case)) is None


@pytest.mark.slow
@settings(quick, max_examples=30)
@given(cases())
def test_oracle_with_every_partner_looked_up_by_time(case):
    with patch.multiple(match_buffer, MAX_MISSES_BEFORE_INDEX=0, MAX_MISSES_WITH_INDEX=0), patch.object(
        interval_index, "MAX_NODE_KEYS", 4
    ):
        assert difference(case) is None


@pytest.mark.slow
@quick
@given(drawn_cases())
def test_oracle_drawn_piece_by_piece(case):
    assert of_engine(case) == answer(case)


@pytest.mark.slow
@quick
@given(cases(depth=3), st.integers(1, 6))
def test_garbage_control_leaves_what_is_young(case, window):
    """Nothing fires that would not have, and everything does of which no part is older than the window."""
    case = replace(case, policy="unrestricted")
    assume(defined_for(case.rules) and not case.has_limits())
    rule = case.rules[0]
    assume(not any(isinstance(node, (Cnot, Fnot)) for node in walk(rule.pattern)))
    steps = engine_steps([case.text()], case.goals() + garbage_control(window), case.stream)
    most = firings(rule, case.stream, case.out_of_order)
    least = firings(rule, case.stream, case.out_of_order, youngest=window)
    for got, maximum, minimum in zip(steps, most, least):
        fired = Counter((term, start / 10**9, end / 10**9) for term, start, end in got[1:])
        assert minimum - fired == Counter()
        assert fired - maximum == Counter()


@pytest.mark.parametrize(
    "pattern",
    ["a seq b", "a and b", "(a seq c) seq b", "a forall_seq b", "a seq b star_times", "(a or c) seq b"],
)
def test_garbage_control_drops_what_is_old(pattern):
    policy = "set_etalis_flag(event_consumption_policy,unrestricted).\n"
    events = stream("a@1 c@2 c@9 c@10 c@11 b@12")
    old = ("out", 10**9, 12 * 10**9)
    assert old in engine_events([f"out <- {pattern}."], policy, events)
    assert old not in engine_events([f"out <- {pattern}."], policy + garbage_control(5), events)


@pytest.mark.slow
@settings(quick, max_examples=30)
@given(cases(depth=3, revision=True))
def test_revision(case):
    if difference(case) is not None:
        pytest.fail(report(shrink(case, lambda smaller: difference(smaller) is not None)), pytrace=False)


@pytest.mark.slow
@quick
@given(cases(), st.integers(1, 10**4))
def test_shifted_in_time(case, seconds):
    assume(not any(isinstance(node, Check) for rule in case.rules for node in walk(rule.pattern)))
    later = [(term, start + seconds, end + seconds) for term, start, end in case.stream]
    shifted = of_engine(case, events=later)
    by = seconds * 10**9
    assert [(term, start - by, end - by) for term, start, end in shifted] == of_engine(case)


def in_forms(stream):
    """Return a stream with its stamps in one form after the other."""
    forms = cycle((datime, to_term, datime6))
    return [(term, *(next(forms)(round(stamp * SECOND)) for stamp in interval)) for term, *interval in stream]


def as_numbers(fired):
    """Return events with the stamps in their terms as numbers of seconds."""
    stamp = re.compile(r"datime\(1970,1,1,0,(\d+),([\d.]+)(?:,0)?\)")
    return [
        (stamp.sub(lambda found: str(int(found[1]) * 60 + int(float(found[2]))), term), *interval)
        for term, *interval in fired
    ]


@pytest.mark.slow
@settings(quick, max_examples=15)
@given(cases())
def test_stamps_in_all_forms(case):
    """What check does with t1 and t2 is the same for numbers and datimes."""
    fired = of_engine(case, events=in_forms(case.stream))
    assert as_numbers(fired) == [(term, *interval) for term, *interval in of_engine(case)]


@pytest.mark.slow
@quick
@given(cases())
def test_variables_renamed(case):
    assert of_engine(case, [case.text("_Other{}x")]) == of_engine(case)


@pytest.mark.slow
@quick
@given(cases(), cases(depth=2))
def test_rules_that_do_not_matter(case, other):
    """Rules of other heads, the same patterns among them, take nothing away."""
    extra = []
    for at, rule in enumerate((*case.rules, *other.rules)):
        if any(isinstance(node, Sub) for node in walk(rule.pattern)):
            continue  # what it defines by the way is no rule of another head
        arguments = rule.head[1:] if rule.head.__class__ is tuple else ()
        head = functor("elsewhere", len(arguments))(*arguments) if arguments else atom("elsewhere")
        extra.append(write_rule(replace(rule, head=head, label=rule.label and f"other{at}")))
    text = "\n".join([*extra[:1], case.text(), *extra[1:]])
    events = [event for event in of_engine(case, [text]) if not event[0].startswith("elsewhere")]
    assert events == of_engine(case)


@pytest.mark.slow
@quick
@given(cases())
def test_file_split(case):
    assert of_engine(case, [write_rule(rule) for rule in case.rules]) == of_engine(case)


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
def test_flags_that_change_no_event(flags, case):
    assert of_engine(case, goals=flags) == of_engine(case)
