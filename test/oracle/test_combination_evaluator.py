"""Comparison of the two evaluators of the oracle, for rules that both support."""

from collections import Counter
from dataclasses import replace
from typing import Any, List

import pytest
from hypothesis import HealthCheck, assume, given, reject, settings
from oracle.combination_evaluator import defined_for, firings
from oracle.evaluator import Program
from oracle.goal_evaluator import show
from oracle.strategies import cases


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
@given(cases())
def test_unrestricted_policy_has_each_combination_once(case: Any) -> None:
    assume(defined_for(case.rules))
    program = Program(case.rules, "unrestricted", case.out_of_order, expiry=False)
    fired: List[Any] = []
    for term, start, end in case.stream:
        derived = program.event(term, start, end)[1:]
        fired.append(Counter((show(event.term), event.start, event.end) for event in derived))
    assert fired == firings(case.rules[0], case.stream, case.out_of_order)


@pytest.mark.slow
@settings(max_examples=60, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
@given(cases())
def test_expiry_changes_nothing_without_late_events(case: Any) -> None:
    assume(case.has_limits())
    in_order = replace(case, stream=tuple(sorted(case.stream, key=lambda event: event[2])))
    try:
        expected = in_order.expected(expiry=True)
    except RecursionError:  # endless recursive rules have no answer
        reject()
    assert expected == in_order.expected(expiry=False)
