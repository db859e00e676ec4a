"""Fuzzer of cases."""

from pathlib import Path
from typing import Any, Iterator, List, Sequence, Tuple

import pytest
from testing.case_texts import fever_file, indent, parse_case
from testing.test_case_run import write_heat_bag

from retalis import Definitions
from retalis.testing import case_fuzzer
from retalis.testing.case_definition import Case, MutationType
from retalis.testing.case_fuzzer import FuzzReport, fuzz_cases
from retalis.testing.case_run import CaseResult, TryOutcome, run_case


@pytest.fixture(autouse=True)
def run_cases_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_cases(
        cases: Sequence[Case], definitions: Definitions, jobs: int
    ) -> Iterator[Tuple[int, CaseResult]]:
        for number, case in enumerate(cases):
            yield number, run_case(case, definitions)

    monkeypatch.setattr(case_fuzzer, "run_cases", run_cases)


def fuzz(case: Case, definitions: Definitions, tries: int = 20, seed: int = 1) -> FuzzReport:
    (report,) = fuzz_cases([case], definitions, 2, tries, seed)
    return report


def fuzz_rules(definitions: Definitions, rules: str, inputs: str, expect: str, **options: Any) -> List[str]:
    """Return the lines of the report about a case with a program, without its name."""
    text = (
        f"rules: |\n{indent(rules, 2)}goals: subscribe(alarm, [], _, t, x)\n"
        f"cases:\n  - {{name: x, input: [{inputs}], expect: {{{expect}}}}}"
    )
    return [line.strip() for line in fuzz(parse_case(text), definitions, **options).format_lines()][1:]


def test_needed_event_is_found(definitions: Definitions) -> None:
    lines = fuzz_rules(
        definitions,
        "alarm <- b where true.",
        "{at: 1, event: a}, {at: 2.5, event: b}",
        "outputs: {contains: [alarm]}",
    )
    robustness, finding = lines
    assert robustness.startswith("robustness ")
    assert robustness.endswith(" of 20: outputs.contains[0]")
    assert finding == "outputs.contains[0] fails if the event at 2.5 s (b) is lost"


def test_delay_is_halved_until_expectation_holds(definitions: Definitions) -> None:
    lines = fuzz_rules(
        definitions,
        "alarm <- a seq absent(b, 2).",
        "{at: 1, event: a}, {at: 2.5, event: b}, {at: 9, event: c}",
        "outputs: none",
        tries=60,
        seed=4,
    )
    # 0.64 s after 2.5 s is the first delay of the sequence that ends after 3 s.
    assert "outputs (no others) fails if the event at 2.5 s (b) is received 0.64 s later" in lines
    assert "outputs (no others) fails if the event at 2.5 s (b) is lost" in lines
    assert not any("(c)" in line for line in lines if "after" not in line)


def test_superfluous_mutations_are_removed(definitions: Definitions) -> None:
    report = fuzz(parse_case(fever_file("outputs: {contains: [ill(ann)]}")), definitions)
    assert {len(finding.mutations) for finding in report.findings} == {1}
    types = [finding.mutations[0].type for finding in report.findings]
    assert types == sorted(types, key=list(MutationType).index)


def test_two_mutations_that_are_needed_remain(definitions: Definitions) -> None:
    lines = fuzz_rules(
        definitions,
        "alarm <- a(_).",
        "{at: 1, event: a(1)}, {at: 2, event: a(2)}",
        "outputs: {count: {min: 1}}",
        tries=60,
    )
    assert lines[1:] == [
        "outputs.count fails if the event at 1 s (a(1)) is lost and the event at 2 s (a(2)) is lost"
    ]


def test_times_may_move_by_the_delay(definitions: Definitions) -> None:
    lines = fuzz_rules(
        definitions,
        "alarm <- b.",
        "{at: 1, event: b}, {at: 9, event: c}",
        "outputs: {contains: [{term: alarm, at: 1}]}",
    )
    assert lines[1:] == ["outputs.contains[0] fails if the event at 1 s (b) is lost"]


def test_equal_seeds_give_equal_reports(definitions: Definitions) -> None:
    case = parse_case(fever_file("outputs: [ill(ann), ill(bob)]"))
    reports = [list(fuzz(case, definitions, 5, seed).format_lines()) for seed in (1, 1, 2)]
    assert reports[0] == reports[1] != reports[2]


def test_all_kinds_of_expectations_are_named(definitions: Definitions) -> None:
    expect = (
        "outputs: {contains: [ill(ann)], count: 2}\n"
        "events: {none: [fever(eve)], in_order: [fever(ann), fever(bob)]}\n"
        'state: [{query: "memory_counter(temperatures, N)", expect: {N: 4}}]'
    )
    report = fuzz(parse_case(fever_file(expect)), definitions)
    assert list(report.survived) == [
        "outputs.contains[0]",
        "outputs.count",
        "events.none[0]",
        "events.in_order[0]",
        "events.in_order[1]",
        "state[0]",
    ]
    assert report.survived["events.none[0]"] == 20
    assert report.survived["state[0]"] < 20


def test_error_of_a_try_is_a_broken_expectation(definitions: Definitions) -> None:
    lines = fuzz_rules(
        definitions,
        "alarm <- a seq absent(b, 2) where X is 1 / 0.",
        "{at: 1, event: a}, {at: 2, event: b}, {at: 9, event: c}",
        "outputs: none",
    )
    assert "errors (no others) fails if the event at 2 s (b) is lost" in lines
    assert lines[0].endswith(" of 20: errors (no others)")


def test_try_without_outcome_is_reported(definitions: Definitions, monkeypatch: pytest.MonkeyPatch) -> None:
    def run_cases(cases: Sequence[Case], *arguments: object) -> Iterator[Tuple[int, CaseResult]]:
        for number, case in enumerate(cases):
            types = {mutation.type for mutation in case.mutations or ()}
            outcome = None if MutationType.LOST in types else TryOutcome((), (), ())
            yield number, CaseResult((), (), 0.0, outcome=outcome)

    monkeypatch.setattr(case_fuzzer, "run_cases", run_cases)
    lines = fuzz_rules(definitions, "x <- a.", "{at: 1, event: a}", "")
    assert lines[0].endswith(" of 20: execution")
    assert lines[1:] == ["execution fails if the event at 1 s (a) is lost"]


def test_messages_of_bag_are_changed(definitions: Definitions, tmp_path: Path) -> None:
    write_heat_bag(tmp_path / "heat.bag", definitions)
    text = (
        "rules: warm(N) <- std_msgs__0__Int8(N).\ntopics: {heat: std_msgs/Int8}\n"
        "cases: [{name: x, input: [{bag: heat.bag}], expect: {events: {contains: [warm(2)]}}}]"
    )
    report = fuzz(parse_case(text, tmp_path / "x_test.yaml"), definitions)
    assert list(report.format_lines())[2:] == [
        "  events.contains[0] fails if the message at 1 s on /heat is lost"
    ]


def test_case_without_input_has_no_tries(definitions: Definitions) -> None:
    report = fuzz(parse_case("rules: a <- b.\ncases: [{name: x, expect: {}}]"), definitions)
    assert report.problem == "no tries: it has no input that can be changed"


def test_failing_case_has_no_tries(definitions: Definitions) -> None:
    report = fuzz(parse_case(fever_file("outputs: none")), definitions)
    assert list(report.format_lines()) == [
        "fuzz mine_test.yaml:7: fever: no tries: without changes, a second run has other results"
    ]


def test_long_lists_of_findings_are_cut(definitions: Definitions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(case_fuzzer, "MAX_LISTED_FINDINGS", 1)
    lines = fuzz_rules(
        definitions,
        "alarm <- a(1) seq a(2).",
        "{at: 1, event: a(1)}, {at: 2, event: a(2)}",
        "outputs: {count: 1}",
    )
    assert [line.partition(" more")[0][:-1] for line in lines if "more findings" in line] == [
        "outputs.count has "
    ]


def test_input_does_not_move_beyond_end(definitions: Definitions) -> None:
    case = parse_case(fever_file("outputs: [ill(ann), ill(bob)]", more="until: 4.02"))
    report = fuzz(case, definitions)
    amounts = [
        mutation.input.time + mutation.amount
        for finding in report.findings
        for mutation in finding.mutations
        if mutation.type in (MutationType.DELAYED, MutationType.OVERTAKEN)
    ]
    assert amounts
    assert all(amount <= 4_020_000_000 for amount in amounts)


@pytest.mark.parametrize(
    ("count", "names"),
    [
        (1, "events.contains[0] fails"),
        (2, "events.contains[0] and events.contains[1] fail"),
        (3, "events.contains[0], events.contains[1] and events.contains[2] fail"),
        (12, "events.contains[0], events.contains[1] and 10 others fail"),
    ],
)
def test_expectations_with_equal_findings_share_a_line(
    definitions: Definitions, count: int, names: str
) -> None:
    lines = fuzz_rules(
        definitions,
        "x(1) <- a(_).",
        "{at: 1, event: a(1)}",
        f"events: {{contains: [{', '.join(['{event: x(1), count: {min: 1}}'] * count)}]}}",
    )
    assert f"{names} if the event at 1 s (a(1)) is lost" in lines
