"""Execution of cases: input, clock, facts, parameters, queries, problems, and explanations."""

import logging
from pathlib import Path

import pytest
from testing.case_texts import fever_file, run_fever, run_text

from retalis import BagWriter, Definitions, functor

PROGRAM = Path(__file__).resolve().parents[2] / "examples" / "cookbook" / "debounce"


def test_outputs_and_events_as_expected(definitions: Definitions) -> None:
    result = run_fever(
        definitions,
        "outputs:\n"
        "  - {at: 3, topic: alarms, id: a, term: ill(ann)}\n"
        "  - {at: 4, topic: alarms, term: ill(bob)}\n"
        "events:\n"
        "  exactly: [{event: fever(ann), start: 1, at: 3}, {event: fever(bob), start: 2, at: 4}]",
    )
    assert result.failures == ()


def test_failure_has_place_listing_and_reason(definitions: Definitions) -> None:
    (failure,) = run_fever(definitions, "outputs: [ill(ann)]\nevents:\n  none: [fever(carl)]").failures
    assert failure.splitlines()[:3] == [
        "mine_test.yaml:12: outputs: 1 expected, 2 found",
        "       3.000 s  alarms  ill(ann)",
        "  +    4.000 s  alarms  ill(bob)",
    ]
    assert failure.splitlines()[3:6] == [
        "        subscription a of topic alarms publishes it for fever(bob)",
        "          fever(bob) [2,4] s by rule fever(Who) <- temperature(Who,A) seq temperature(Who,B) within 60 "
        "where A > 38,B > 38 (mine_test.yaml:2)",
        "            temperature(bob,39) at 2 s came from outside",
    ]


@pytest.mark.parametrize(
    "item",
    ["{topic: warm, message: {data: 11}}", "{topic: warm, term: 'std_msgs__0__Int8(11)', at: 1}"],
)
def test_missing_message_has_reason_of_its_event(item: str, definitions: Definitions) -> None:
    text = (
        "rules: low(V) <- level(V) where V < 11.\n"
        "goals: subscribe(low(V), [], std_msgs__0__Int8(V), warm, w)\n"
        f"cases: [{{name: x, input: [{{at: 1, event: level(11)}}], expect: {{outputs: [{item}]}}}}]"
    )
    (failure,) = run_text(text, definitions).failures
    assert "subscription w of topic warm publishes it for low(" in failure
    assert "- where " in failure
    assert "false" in failure


def test_late_output_names_its_event(definitions: Definitions) -> None:
    expect = "outputs: {contains: [{term: ill(bob), at: 9}, {topic: cold, term: x}]}"
    (failure,) = run_fever(definitions, expect).failures
    assert "ill(bob)    (found at 4.000 s)" in failure
    assert "publishes it for fever(bob), which ended at another time" in failure
    assert "no subscription of topic cold publishes such a term" in failure


def test_outputs_in_another_order_have_no_reasons(definitions: Definitions) -> None:
    expect = "outputs: {in_order: [ill(bob), ill(ann)]}"
    (failure,) = run_fever(definitions, expect).failures
    assert "rule" not in failure


def test_missing_event_is_explained_by_its_rule(definitions: Definitions) -> None:
    (failure,) = run_fever(definitions, "events:\n  contains: [fever(carl)]").failures
    assert "events: 1 not found as expected" in failure
    assert "rule fever(carl) <-" in failure
    assert "(mine_test.yaml:2)" in failure
    assert "- temperature(carl,A): did not happen" in failure


def test_clock_and_alarms_advance_to_end(definitions: Definitions) -> None:
    text = (
        "rules: silent <- hello seq absent(hello, 10).\n"
        "cases: [{name: x, input: [{at: 1, event: hello}], until: %s, expect: {events: {contains: "
        "[{event: silent, count: %d}]}}}]"
    )
    for until, count in ((10.9, 0), (11, 1)):
        assert run_text(text % (until, count), definitions).failures == ()


def test_end_is_last_input_by_default(definitions: Definitions) -> None:
    text = (
        "rules: silent <- hello seq absent(hello, 10).\n"
        "cases: [{name: x, input: [{at: 1, event: hello}], expect: {events: {exactly: [hello], none: [silent]}}}]"
    )
    assert run_text(text, definitions).failures == ()


def test_query_sees_state_at_its_time(definitions: Definitions) -> None:
    result = run_fever(
        definitions,
        "state:\n"
        '  - {at: 0.5, query: "memory_counter(temperatures, N)", expect: {N: 0}}\n'
        '  - {at: 2, query: "memory_counter(temperatures, N)", expect: {N: 2}}\n'
        '  - {query: "memory_counter(temperatures, N)", expect: {N: 4}}\n'
        '  - {query: "member(X, [1, 2.5])", expect: [{X: 1}, {X: 2.5}]}\n'
        '  - {query: "member(X, [])", expect: false}\n'
        '  - {query: "member(1, [1])"}',
    )
    assert result.failures == ()


@pytest.mark.parametrize(
    ("state", "problem"),
    [
        ('{query: "member(X, [1, 2])", expect: {X: 1}}', "expected X=1, found X=1; X=2"),
        ('{query: "member(X, [1, 2])", expect: [{X: 1}, {X: 3}]}', "expected X=1; X=3, found X=1; X=2"),
        ('{query: "member(X, [1])", expect: false}', "expected no solution, found X=1"),
        ('{query: "fail"}', "query fail at the end: has no solution"),
        ('{at: 1.5, query: "fail"}', "query fail at 1.5 s: has no solution"),
        ('{query: "X is a"}', "query X is a at the end: Type error"),
        ('{query: "member(X, [1])", expect: {Y: 1}}', "the query has no variable Y"),
        ('{query: "member(X, [a])", expect: {X: B}}', "'B': variable B occurs once, and matches anything"),
    ],
)
def test_wrong_answer_is_a_failure(state: str, problem: str, definitions: Definitions) -> None:
    (failure,) = run_fever(definitions, f"state: [{state}]").failures
    assert problem in failure
    assert failure.startswith("mine_test.yaml:12:")


def test_facts_and_parameters(definitions: Definitions) -> None:
    text = (
        "rules: high(W) <- heat(W, T) where (limit(W, L), T > L).\n"
        "facts: ['limit(ann, 38)', 'limit(bob, 40)']\n"
        "parameters: {max_depth: 5}\n"
        "cases: [{name: x, input: [{at: 1, event: 'heat(ann, 39)'}, {at: 2, event: 'heat(bob, 39)'}],"
        " expect: {events: [high(ann)]}}]"
    )
    assert run_text(text, definitions).failures == ()


@pytest.mark.parametrize(("parameters", "warnings"), [("parameters: {}\n", 0), ("", 1)])
def test_missing_parameter_has_warning_without_any(
    parameters: str, warnings: int, definitions: Definitions
) -> None:
    text = (
        "rules: |\n  limit(L) :- ros_param('/limit', L), !.\n  limit(5).\n  hot <- heat(T) where (limit(L), T > L).\n"
        f"{parameters}cases: [{{name: x, input: [{{at: 1, event: heat(6)}}], expect: {{events: [hot]}}}}]"
    )
    result = run_text(text, definitions)
    assert result.failures == ()
    assert sum("ros_param" in warning for warning in result.warnings) == warnings


def test_errors_fail_unless_expected(definitions: Definitions) -> None:
    text = (
        "rules: |\n  hot <- heat(T) where T > 40.\n"
        "cases: [{name: x, input: [{at: 1, event: heat(much)}], expect: {%s}}]"
    )
    (failure,) = run_text(text % "", definitions).failures
    assert failure.startswith("unexpected error: mine_test.yaml:2:")
    assert run_text(text % "errors: [much]", definitions).failures == ()
    unexpected, missing = run_text(text % "errors: [little]", definitions).failures
    assert unexpected == failure
    assert missing == "mine_test.yaml:3: expected error missing: little"


def test_warnings_matter_only_if_stated(definitions: Definitions) -> None:
    text = "rules: a <- b.\ncases: [{name: x, expect: {%s}}]"
    result = run_text(text % "", definitions)
    assert result.failures == ()
    assert any("no consumer of a/0" in warning for warning in result.warnings)
    assert run_text(text % "warnings: ['no consumer of a/0']", definitions).failures == ()
    (failure,) = run_text(text % "warnings: none", definitions).failures
    assert failure.startswith("unexpected warning: mine_test.yaml:1:1: no consumer of a/0")


def test_only_bags_should_have_all_topics(definitions: Definitions, tmp_path: Path) -> None:
    text = f"program: {PROGRAM}\ncases: [{{name: x, input: [%s], expect: {{warnings: none}}}}]"
    path = tmp_path / "x_test.yaml"
    assert run_text(text % "{at: 1, event: now}", definitions, path).failures == ()
    write_heat_bag(tmp_path / "heat.bag", definitions)
    (failure,) = run_text(text % "{bag: heat.bag}", definitions, path).failures
    assert "has no messages on button; it has /heat (std_msgs/Int8)" in failure


def test_syntax_error_of_rules_has_place_in_file(definitions: Definitions) -> None:
    text = "rules: |\n  a <- b.\n  c <- .\ncases: [{name: x, expect: {}}]"
    (failure,) = run_text(text, definitions).failures
    assert failure.startswith("unexpected error: mine_test.yaml:3:6: ")


def test_error_of_goals_has_place_in_file(definitions: Definitions) -> None:
    text = (
        "rules: a <- b.\ngoals: |\n  memorize(a, [], _, m, 5)\n  memorise(b)\ncases: [{name: x, expect: {}}]"
    )
    (failure,) = run_text(text, definitions).failures
    assert failure.startswith("unexpected error: mine_test.yaml:4:1: ")


def test_refused_event_is_an_error_at_its_place(definitions: Definitions) -> None:
    text = (
        "rules: |\n  :- event heat(t:number).\n  hot <- heat(_).\n"
        "cases:\n  - name: x\n    input:\n      - {at: 1, event: heat(much)}\n    expect: {}"
    )
    (failure,) = run_text(text, definitions).failures
    assert failure.startswith("unexpected error: mine_test.yaml:7:")


def test_messages_become_events_of_program(definitions: Definitions) -> None:
    text = (
        f"program: {PROGRAM}\n"
        "cases: [{name: x, input: [{at: 1, topic: button, message: {data: true}},"
        " {at: 1.1, topic: button, message: {data: false}}], until: 5,"
        " expect: {outputs: [{term: std_msgs__0__Empty, topic: pressed, at: 1.05}]}}]"
    )
    assert run_text(text, definitions).failures == ()


def write_heat_bag(path: Path, definitions: Definitions) -> None:
    """Write a bag with the numbers 1, 2 and 3 on topic ``heat`` at 100, 101 and 102 s, and one on ``other``."""
    definition = definitions.find("std_msgs/Int8")
    with BagWriter(path) as bag:
        heat, other = bag.add("/heat", definition), bag.add("/other", definition)
        for number in (1, 2, 3):
            data = definitions.encoder(definition).encode(functor("std_msgs__0__Int8", 1)(number), "heat")
            bag.write(heat, (99 + number) * 10**9, data)
        bag.write(other, 103 * 10**9, data)


BAG_CASE = """\
rules: |
  warm(N) <- std_msgs__0__Int8(N).
topics: {{heat: std_msgs/Int8, other: std_msgs/Int8}}
cases:
  - name: bag
    input:
      - {{bag: heat.bag{options}}}
      - {{at: 1.5, event: now}}
    expect:
      events: [{events}]
"""


@pytest.mark.parametrize(
    ("options", "events"),
    [
        (
            "",
            "{event: warm(1), at: 0}, {event: warm(2), at: 1}, {event: warm(3), at: 2}, {event: warm(3), at: 3}",
        ),
        (", topics: [heat]", "{event: warm(1), at: 0}, {event: warm(2), at: 1}, {event: warm(3), at: 2}"),
        (", start: 1, duration: 1.5", "{event: warm(2), at: 0}, {event: warm(3), at: 1}"),
    ],
)
def test_case_with_bag_starts_with_its_first_message(
    options: str, events: str, definitions: Definitions, tmp_path: Path
) -> None:
    write_heat_bag(tmp_path / "heat.bag", definitions)
    text = BAG_CASE.format(options=options, events=events)
    assert run_text(text, definitions, tmp_path / "x_test.yaml").failures == ()


def test_unknown_topic_of_bag_is_an_error(definitions: Definitions, tmp_path: Path) -> None:
    write_heat_bag(tmp_path / "heat.bag", definitions)
    text = BAG_CASE.format(options=", topics: [haet]", events="warm(1)")
    (failure,) = run_text(text, definitions, tmp_path / "x_test.yaml").failures
    assert f"bag: {tmp_path}/heat.bag has no topic 'haet': it has /heat, /other" in failure


def test_published_message_is_compared_by_slots(definitions: Definitions, tmp_path: Path) -> None:
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><publish_to name="place" msg_type="geometry_msgs/Point"/></publish_subscribe>'
    )
    (tmp_path / "goalPredicates.txt").write_text(
        "subscribe(at(X, Y), [], geometry_msgs__0__Point(X, Y, 0.0), place, p)\n"
    )
    text = (
        "cases: [{name: x, input: [{at: 1, event: 'at(1.0, 2.0)'}],"
        " expect: {outputs: [{topic: place, message: %s}]}}]"
    )
    path = tmp_path / "x_test.yaml"
    assert run_text(text % "{x: 1, y: 2}", definitions, path).failures == ()
    assert run_text(text % "{y: 2.05}, tolerances: {y: 0.1}", definitions, path).failures == ()
    (failure,) = run_text(text % "{x: 1, y: 3}", definitions, path).failures
    assert "the message at 1.000 s: y is 2.0, expected 3" in failure
    (failure,) = run_text(text % "{w: 1}", definitions, path).failures
    assert "geometry_msgs/Point has no slot w" in failure


def test_state_of_process_is_restored(definitions: Definitions) -> None:
    logger = logging.getLogger("retalis")
    before = (list(logger.handlers), logger.propagate)
    run_fever(definitions, "outputs: none")
    assert (list(logger.handlers), logger.propagate) == before


def test_query_with_endless_solutions_ends(definitions: Definitions) -> None:
    state = '[{query: "between(1, inf, X)", expect: false}, {query: "between(1, inf, X)", expect: {X: 1}}]'
    failures = run_fever(definitions, f"state: {state}").failures
    assert [failure.rpartition(", ")[2] for failure in failures] == ["found X=1", "found X=1; X=2"]


def test_failure_that_does_not_recur_remains_a_failure(definitions: Definitions) -> None:
    text = (
        "rules: small(X) <- hello where (random(X), X < 0.5).\n"
        "cases: [{name: x, input: [{at: 1, event: hello}], expect: {events: {contains: [small(_)]}}}]"
    )
    # About half of the first runs fail, and about half of their second runs have another result.
    assert any(
        "not deterministic" in failure for _ in range(24) for failure in run_text(text, definitions).failures
    )


def test_failure_that_depends_on_recording_is_not_called_random(definitions: Definitions) -> None:
    text = (
        "rules: on <- hello where get_etalis_flag(etalis_justification, on).\n"
        "cases: [{name: x, input: [{at: 1, event: hello}], expect: {events: {contains: [on]}}}]"
    )
    reason = run_text(text, definitions).failures[-1]
    assert "the run that records the origin of events had other results" in reason
    assert "one without it had the same" in reason


def test_error_that_quotes_a_line_has_that_of_the_file(definitions: Definitions) -> None:
    text = (
        "# A comment.\nrules: |\n  same: a <- b.\n  same: c <- d.\ngoals: |\n\n  subscribe(a, [], _, t, x)\n"
        "cases: [{name: x, expect: {}}]"
    )
    warnings = run_text(text, definitions).warnings
    assert any(
        text.startswith("mine_test.yaml:4:1: another rule (line 3) has the label same") for text in warnings
    )


def test_unknown_names_in_expectations_are_failures(definitions: Definitions) -> None:
    problems = {
        "outputs: {none: [{topic: alrms, term: _}]}": "no output on topic 'alrms'; did you mean alarms?",
        "outputs: {contains: [{topic: alrms, term: _, count: 0}]}": "no output on topic 'alrms'",
        "events: {none: ['fevr(_)']}": "events: the program has no event 'fevr'; did you mean fever?",
    }
    for expect, problem in problems.items():
        (failure,) = run_fever(definitions, expect).failures
        assert failure.startswith("mine_test.yaml:12:")
        assert problem in failure


def test_absent_events_and_topics_of_program_are_known(definitions: Definitions) -> None:
    for expect in (
        "outputs: {none: [{topic: /alarms, term: ill(eve)}]}",
        "events: {none: [fever(eve), _, 'temperature(eve, _)']}",
    ):
        failures = run_fever(definitions, expect).failures
        assert not any("the program has no" in failure for failure in failures)
    text = (
        "rules: a <- b.\ntopics: {heat: std_msgs/Int8}\n"
        "cases: [{name: x, expect: {events: {none: [std_msgs__0__Int8(_)]}}}]"
    )
    assert run_text(text, definitions).failures == ()


def test_name_in_comment_is_no_event(definitions: Definitions) -> None:
    text = fever_file("events: {none: ['fevr(_)']}").replace(
        "rules: |\n", "rules: |\n  % fevr was the old name\n"
    )
    (failure,) = run_text(text, definitions).failures
    assert "the program has no event 'fevr'" in failure


def test_incomplete_bag_is_a_warning(definitions: Definitions, tmp_path: Path) -> None:
    bag = tmp_path / "heat.bag"
    write_heat_bag(bag, definitions)
    bag.write_bytes(bag.read_bytes()[:-50])
    text = BAG_CASE.format(options="", events="warm(1), warm(2), warm(3), warm(3)")
    result = run_text(text, definitions, tmp_path / "x_test.yaml")
    assert result.failures == ()
    (description,) = result.incomplete_files
    assert description.startswith(f"{bag} is incomplete: its index is cut or damaged at byte ")
    assert description in result.warnings
    failures = run_text(f"{text}      warnings: none\n", definitions, tmp_path / "x_test.yaml").failures
    assert f"unexpected warning: {description}" in failures
