"""Checks of a program before it runs, and explanations of missing events and of unsuitable outputs."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import compound, place_of

from retalis import Definitions, Engine, Operators, RetalisError
from retalis.engine.program_check import check_program, explain_missing_events, explain_output_mismatch
from retalis.events.program.topic_configuration import Topics, topic_type
from retalis.prolog.syntax.term_reader import read_term

TOPICS = Topics((topic_type("speech", "std_msgs/String"),))


@pytest.mark.parametrize(
    ("pattern", "warning"),
    [
        ("alram(_)", "no producer of alram/1: no topic, rule or goal; did you mean alarm/1?"),
        (
            "crash",
            "no producer of crash/0: no topic, rule or goal; if another program sends it, add the fact "
            "input_event(crash/0).",
        ),
        ("alarm(_)", ""),
        ("button(_)", ""),
        ("_", ""),
        ("sensor_msgs__0__Range(_, _, _, _, _, _)", ""),
    ],
)
def test_pattern_without_producer_is_explained(definitions: Definitions, pattern: str, warning: str) -> None:
    engine = Engine()
    engine.load(rules="alarm(T) <- std_msgs__0__String(T). input_event(button/1).")
    term = engine.query(f"X = ({pattern})")[0]["X"]
    assert explain_missing_events(engine, term, definitions, TOPICS, ()) == warning


def test_findings_have_order_of_files(tmp_path: Path, definitions: Definitions) -> None:
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="s" msg_type="a/B" x="1"/></publish_subscribe>'
    )
    (tmp_path / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\nmemorize(d, [], _, m, 5)\nfial\n"
    )
    (tmp_path / "rules.txt").write_text("a <- b within 1000000.\na <- a.\n")
    places = [
        (place_of(finding.problem).source.rpartition("/")[2], place_of(finding.problem).line)
        for finding in check_program(tmp_path, definitions)
    ]
    assert places == [("goalPredicates.txt", 3), ("pub_sub.xml", 1), ("rules.txt", 1), ("rules.txt", 2)]


def test_missing_program_is_one_error(tmp_path: Path, definitions: Definitions) -> None:
    for missing in (tmp_path / "none.pl", tmp_path / "none"):
        (finding,) = check_program(missing, definitions)
        assert finding.problem.message == f"cannot read {missing}: there is no such file or folder"
        with pytest.raises(RetalisError, match="there is no such file or folder"):
            Engine().load_program(missing)


@pytest.mark.parametrize(
    ("subscription", "mismatch"),
    [
        ("subscribe(a(X), [], std_msgs__0__Int32(X), out, 1)", ""),
        ("subscribe(a(X), [], X, out, 1)", ""),
        (
            "subscribe(a(X), [], _, out, 1)",
            "topic out, std_msgs/Int32: expected std_msgs__0__Int32/1, got a/1",
        ),
        (
            "subscribe(a, [], std_msgs__0__Int32(big), out, 1)",
            "topic out, std_msgs/Int32, slot data: expected int32, got the atom big",
        ),
    ],
)
def test_output_of_other_type_is_explained(subscription: str, mismatch: str) -> None:
    goal = compound(read_term(subscription, Operators.prolog()).term)
    assert explain_output_mismatch(goal, "out", "std_msgs/Int32", Definitions()) == mismatch
    assert explain_output_mismatch(goal, "out", "far_msgs/Unknown", Definitions()) == ""


def finding_messages(
    folder: Path, definitions: Any, topics: str = "", rules: str = "", goals: str = ""
) -> List[Any]:
    (folder / "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
    (folder / "eventRules.txt").write_text(rules)
    (folder / "goalPredicates.txt").write_text(f"compile_event_file('eventRules.txt')\n{goals}\n")
    return [finding.problem.message for finding in check_program(folder, definitions)]


def test_events_of_refused_topics_are_not_reported(tmp_path: Path, definitions: Definitions) -> None:
    topics = '<subscribe_to name="speech" msg_type="std_msgs/String" event="Speech"/>'
    (message,) = finding_messages(
        tmp_path, definitions, topics, "a(T) <- speech{data: T}. b(T) <- speach(T)."
    )
    assert message.startswith("<subscribe_to>: the name of an event begins with a small letter")


def test_predicates_of_refused_rules_are_not_reported(tmp_path: Path, definitions: Definitions) -> None:
    goals = "subscribe(low(V), [helper(V)], V, warn, w1)\nmemorize(low(m), [], m, lows, 3)"
    (message,) = finding_messages(
        tmp_path, definitions, rules="low(V) <- heat(V) where helper(V.\nhelper(V) :- V < 3.\n", goals=goals
    )
    assert message.startswith('expected ")" for the "("')


def test_predicates_of_valid_rules_are_reported(tmp_path: Path, definitions: Definitions) -> None:
    messages = finding_messages(tmp_path, definitions, rules="low(V) <- heat(V) where helper(V).")
    assert "there is no predicate helper/1 yet; define it, or write :- dynamic helper/1." in messages


def test_predicates_of_later_files_are_not_reported(tmp_path: Path, definitions: Definitions) -> None:
    (tmp_path / "names.txt").write_text("known(ann).\n")
    messages = finding_messages(
        tmp_path,
        definitions,
        rules="low(V) <- heat(V) where known(V).",
        goals="compile_event_file('names.txt')\nsubscribe(low(V), [], V, warn, w1)",
    )
    assert not any("known/1" in message for message in messages)


def test_other_mistake_at_place_of_load_warning_is_reported(tmp_path: Path, definitions: Definitions) -> None:
    rules = tmp_path / "rules.pl"
    rules.write_text("alarm(X) <- alarm(_).\nfire <- Any.\n")
    messages = [
        (finding.problem.place.line, finding.problem.place.column, finding.problem.message[:40])
        for finding in check_program(rules, definitions)
        if finding.problem.place is not None
    ]
    assert messages == [
        (1, 1, "nothing in the pattern can bind X in the"),
        (1, 1, "alarm/1 fires itself, at once and withou"),
        (1, 7, "X occurs only here: a misspelt name? Oth"),
        (2, 9, "Any is any event, those of this rule inc"),
    ]
