"""The engine against the oracle on random rules and streams, and against itself where nothing may change.

The oracle (``test/oracle``) is an evaluator of its own; its README has the command for long runs.
"""

from dataclasses import replace

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracle.comparison import answers, difference, engine_events, report, shrink
from oracle.patterns import Check, walk
from oracle.strategies import cases, drawn_cases
from oracle.text import write_rule

from retalis.terms import atom, functor

quick = settings(max_examples=60, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))


def of_engine(case, texts=None, goals="", stream=None):
    return engine_events(
        texts or [case.text()], case.goals() + goals, case.stream if stream is None else stream
    )


@settings(quick, max_examples=500)
@given(cases())
def test_oracle(case):
    if difference(case) is not None:
        pytest.fail(report(shrink(case, lambda smaller: difference(smaller) is not None)), pytrace=False)


@quick
@given(drawn_cases())
def test_oracle_drawn_piece_by_piece(case):
    assert of_engine(case) in answers(case)


@settings(quick, max_examples=150)
@given(cases(depth=3, revision=True))
def test_revision(case):
    if difference(case) is not None:
        pytest.fail(report(shrink(case, lambda smaller: difference(smaller) is not None)), pytrace=False)


@quick
@given(cases(), st.integers(1, 10**4))
def test_shifted_in_time(case, seconds):
    assume(not any(isinstance(node, Check) for rule in case.rules for node in walk(rule.pattern)))
    later = [(term, start + seconds, end + seconds) for term, start, end in case.stream]
    shifted = of_engine(case, stream=later)
    by = seconds * 10**9
    assert [(term, start - by, end - by) for term, start, end in shifted] == of_engine(case)


@quick
@given(cases())
def test_variables_renamed(case):
    assert of_engine(case, [case.text("_Other{}x")]) == of_engine(case)


@quick
@given(cases(), cases(depth=2))
def test_rules_that_do_not_matter(case, other):
    """Rules of other heads, the same patterns among them, take nothing away."""
    extra = []
    for at, rule in enumerate((*case.rules, *other.rules)):
        arguments = rule.head[1:] if rule.head.__class__ is tuple else ()
        head = functor("elsewhere", len(arguments))(*arguments) if arguments else atom("elsewhere")
        extra.append(write_rule(replace(rule, head=head, label=rule.label and f"other{at}")))
    text = "\n".join([extra[0], case.text(), *extra[1:]])
    events = [event for event in of_engine(case, [text]) if not event[0].startswith("elsewhere")]
    assert events == of_engine(case)


@quick
@given(cases())
def test_file_split(case):
    assert of_engine(case, [write_rule(rule) for rule in case.rules]) == of_engine(case)


@pytest.mark.parametrize(
    "flags",
    [
        "set_etalis_flag(rule_sharing,on).\n",
        "set_etalis_flag(etalis_justification,on).\n",
        "set_etalis_flag(revision_flag,on).\n",
        "set_etalis_flag(garbage_control,general).\nset_etalis_flag(garbage_window,100000).\n"
        "set_etalis_flag(garbage_window_step,1).\n",
    ],
    ids=["sharing", "justification", "revision", "garbage_control"],
)
@quick
@given(case=cases())
def test_flags_that_change_no_event(flags, case):
    assert of_engine(case, goals=flags) == of_engine(case)
