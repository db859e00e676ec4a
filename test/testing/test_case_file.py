"""Test files: their format, its JSON Schema, and errors."""

from pathlib import Path
from typing import Any

import pytest
from testing.case_texts import fever_file, parse_case

from retalis.foundation.errors import UsageError
from retalis.testing.case_definition import CountRange, Tolerance
from retalis.testing.case_file import (
    is_foreign_file,
    list_case_files,
    make_json_schema,
    parse_case_file,
    read_case_file,
)
from retalis.testing.yaml_documents import CaseFileError

SECOND = 10**9


def parse_error(text: str) -> str:
    """Return the first line of the error of a file."""
    with pytest.raises(CaseFileError) as raised:
        parse_case_file(text, Path("mine_test.yaml"))
    return str(raised.value).splitlines()[0]


def test_input_is_sorted_by_time() -> None:
    case = parse_case(fever_file("outputs: none", inputs="[{at: 2, event: b}, {at: 1, event: a}]"))
    assert [(event.time, event.event.text) for event in case.events] == [(SECOND, "a"), (2 * SECOND, "b")]


def test_repetition_rounds_each_time_by_itself() -> None:
    case = parse_case(fever_file("outputs: none", inputs="[{at: 0, event: a, every: 0.1, count: 50}]"))
    assert [event.time for event in case.events] == [number * SECOND // 10 for number in range(50)]


def test_interval_event_is_received_at_its_end() -> None:
    case = parse_case(fever_file("outputs: none", inputs="[{event: a, interval: [1, 2.5]}]"))
    (event,) = case.events
    assert (event.time, event.start, event.end) == (5 * SECOND // 2, SECOND, 5 * SECOND // 2)


def test_message_input_has_slots() -> None:
    case = parse_case(
        fever_file("outputs: none", inputs="[{at: 1, topic: /t, type: std_msgs/Int8, message: {data: 3}}]")
    )
    (message,) = case.messages
    assert (message.topic, message.type) == ("/t", "std_msgs/Int8")
    assert message.value is not None
    assert message.value.plain() == {"data": 3}


def test_values_of_file_are_defaults_of_cases() -> None:
    text = (
        "rules: a <- b.\nstart: 5\nparameters: {max_gap: 2}\n"
        "cases: [{name: one, expect: {}}, {name: two, start: 7, rules: c <- d., expect: {}}]"
    )
    one, two = parse_case_file(text, Path("mine_test.yaml"))
    assert (one.start, two.start) == (5 * SECOND, 7 * SECOND)
    assert one.program.rules is not None
    assert two.program.rules is not None
    assert (one.program.rules.text, two.program.rules.text) == ("a <- b.", "c <- d.")
    assert one.program.parameters == two.program.parameters == (("max_gap", 2),)


def test_expectations_have_tolerances() -> None:
    case = parse_case(
        fever_file(
            "tolerance: 0.5\nwithin: 0.1\noutputs:\n"
            "  contains: [{term: f(1), count: {min: 2}}, {term: g, within: 2, tolerance: {relative: 0.1}}]"
        )
    )
    (sequence,) = case.expectations.sequences
    first, second = sequence.items
    assert (first.tolerance, first.within, first.occurrences) == (
        Tolerance(0.5, 0),
        SECOND // 10,
        CountRange(2, None),
    )
    assert (second.tolerance, second.within, second.occurrences) == (Tolerance(0, 0.1), 2 * SECOND, None)


def test_path_in_place_of_expectations_is_golden_file() -> None:
    case = parse_case("rules: a <- b.\ncases: [{name: x, expect: golden.jsonl}]", Path("tests/mine.yaml"))
    assert case.expectations.golden == Path("tests/golden.jsonl")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("case: []", "mine_test.yaml:1:1: unknown key 'case': expected cases, program, rules, goals, topics, facts, "
         "parameters, services, start or timeout; did you mean cases?"),
        ("rules: a <- b.", "mine_test.yaml: has no key 'cases'"),
        ("cases: []", "mine_test.yaml:1:8: cases: expected at least one case"),
        ("cases: [{expect: {}}]", "mine_test.yaml:1:9: a case without name: expected the key 'name'"),
        ("rules: a <- b.\ncases: [{name: x}]", "mine_test.yaml:2:9: a case without expectations: "
         "expected the key 'expect'"),
        ("rules: a <- b.\ncases: [{name: x, expect: {}}, {name: x, expect: {}}]",
         "mine_test.yaml:2:32: the name 'x' is given twice"),
        ("rules: a <- b.\nprogram: p\ncases: [{name: x, expect: {}}]",
         "mine_test.yaml:1:8: rules: expected either 'rules' or 'program'"),
        ("rules: a <- b.\nparameters: {max_gpa: 5}\ncases: [{name: x, expect: {}}]", "mine_test.yaml:2:23: "
         "parameters: the node has no parameter 'max_gpa' for cases; did you mean max_gap?"),
        ("rules: a <- b.\nparameters: {dock_after: 5}\ncases: [{name: x, expect: {}}]", "mine_test.yaml:2:26: "
         "parameters: the node has no parameter 'dock_after' for cases; a ROS parameter is written '/dock_after'"),
        ("program: nowhere\ncases: [{name: x, expect: {}}]", "mine_test.yaml:1:10: program: there is no folder "
         "'nowhere'"),
    ],
)  # fmt: skip
def test_invalid_file_is_an_error_with_place(text: str, error: str) -> None:
    assert parse_error(text) == error


@pytest.mark.parametrize(
    ("inputs", "error"),
    [
        ("[{at: 1}]", "input[0]: expected one of the keys 'event', 'topic' and 'bag'"),
        ("[{event: a}]", "input[0]: expected the key 'at'"),
        ("[{at: 1, event: a, topic: b}]", "input[0]: expected one of the keys 'event', 'topic' and 'bag'"),
        ("[{at: 1, event: a, message: {}}]", "input[0]: key 'message' does not belong to 'event'"),
        ("[{at: 1, evnt: a}]", "unknown key 'evnt': expected at, event, interval, topic, type, message, every, "
         "count, bag, start, duration or topics; did you mean event?"),
        ("[{at: -1, event: a}]", "at: -1 is too small: expected at least 0"),
        ("[{at: 1, event: a, every: 2}]", "every: expected the key 'count', too"),
        ("[{at: 1, event: a, count: 2}]", "count: expected the key 'every', too"),
        ("[{at: 1, event: a, every: 0, count: 2}]", "every: expected more than 0 seconds"),
        ("[{at: 1, event: a, every: 1, count: 9000000}]", "count: expected at most 1000000"),
        ("[{event: a, interval: [2, 1]}]", "interval: the end is before the start"),
        ("[{at: 1, event: f(a, b)}]", "unknown key 'b)': expected at, event, interval, topic, type, message, every, "
         "count, bag, start, duration or topics; YAML splits at commas: write a term with commas in quotes, as "
         '"f(a, b)"'),
        ("[{event: a, interval: [2]}]", "interval: expected two times, [start, end]"),
        ("[{bag: none.bag}]", "bag: there is no file 'none.bag'"),
    ],
)  # fmt: skip
def test_invalid_input_is_an_error(inputs: str, error: str) -> None:
    assert parse_error(fever_file("outputs: none", inputs=inputs)).partition(": ")[2] == error


@pytest.mark.parametrize(
    ("expect", "error"),
    [
        ("output: none", "unknown key 'output': expected outputs, events, golden, state, errors, warnings, tolerance "
         "or within; did you mean outputs?"),
        ("events: none", "events: expected a list of the events that must not occur: none: [TERM]"),
        ("outputs: [{event: a}]", "outputs[0]: key 'event': not a key of outputs"),
        ("outputs: {contain: []}", "unknown key 'contain': expected exactly, contains, in_order, none or count; did "
         "you mean contains?"),
        ("outputs: [{at: 1}]", "outputs[0]: expected the key 'term'"),
        ("outputs: [{term: a, count: 2}]", "outputs[0]: key 'count': only 'contains' has counts"),
        ("outputs: [{term: a, start: 2}]", "outputs[0]: key 'start': not a key of outputs"),
        ("events: [{event: a, topic: b}]", "events[0]: key 'topic': not a key of events"),
        ("outputs: {count: {min: 3, max: 2}}", "count: max is less than min"),
        ("state: [{expect: true}]", "state[0]: expected the key 'query'"),
        ("state: [{query: a, expect: 3}]", "expect: expected true or false, found '3'"),
    ],
)  # fmt: skip
def test_invalid_expectation_is_an_error(expect: str, error: str) -> None:
    assert parse_error(fever_file(expect)).partition(": ")[2] == error


def test_unreadable_files_are_errors(tmp_path: Path) -> None:
    (tmp_path / "latin.yaml").write_bytes(b"cases: \xff")
    for name, error in (
        ("none.yaml", "No such file or directory"),
        ("latin.yaml", "byte 7 is not UTF-8 text"),
    ):
        with pytest.raises(CaseFileError, match=error):
            read_case_file(tmp_path / name)


def test_test_files_are_found_below_folders(tmp_path: Path) -> None:
    for name in ("tests/a.yaml", "b_test.yaml", "c.yaml", ".hidden/tests/d.yaml", "tests/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("# Cases.\ncases: []\n")
    (tmp_path / "tests" / "robot.yml").write_text("wheels: 2\n")
    files, skipped = list_case_files([tmp_path, tmp_path / "c.yaml"])
    names = [path.relative_to(tmp_path).as_posix() for path in files]
    assert names == ["b_test.yaml", "tests/a.yaml", "c.yaml"]
    assert skipped == [tmp_path / "tests" / "robot.yml"]
    with pytest.raises(UsageError, match="does not exist"):
        list_case_files([tmp_path / "nowhere"])


def collect_references(schema: Any) -> Any:
    """Yield the names of all definitions that a schema refers to."""
    if isinstance(schema, dict):
        if "$ref" in schema:
            yield schema["$ref"].rpartition("/")[2]
        for part in schema.values():
            yield from collect_references(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from collect_references(part)


def test_json_schema_defines_what_it_refers_to() -> None:
    schema = make_json_schema()
    assert set(collect_references(schema)) == set(schema["definitions"])


def test_end_before_last_input_is_an_error() -> None:
    text = fever_file("outputs: none", more="until: 2", inputs="[{at: 9, event: a}]")
    assert parse_error(text).partition(": ")[2] == "until: 2 s is before the last input or query, at 9 s"


@pytest.mark.parametrize("expect", ["events: []", "events: {none: []}", "outputs: {contains: []}"])
def test_empty_expectation_is_an_error(expect: str) -> None:
    assert "an empty list expects nothing" in parse_error(fever_file(expect))


@pytest.mark.parametrize("value", ["-1", "0", "1e300"])
def test_timeout_is_limited(value: str) -> None:
    text = f"rules: a <- b.\ncases: [{{name: x, timeout: {value}, expect: {{}}}}]"
    assert "timeout: " in parse_error(text)


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        ("9" * 400, "at most 1000000000"),
        ("1e300", "at most 1000000000"),
        ("-" + "9" * 400, "at least 0"),
        ("1" + "0" * 12, "at most 1000000000"),
    ],
)
def test_times_are_limited(time: str, expected: str) -> None:
    error = parse_error(fever_file("outputs: none", inputs=f"[{{at: {time}, event: a}}]"))
    assert f": expected {expected}" in error


def test_cases_cannot_share_golden_file() -> None:
    text = "rules: a <- b.\ncases: [{name: x, expect: g.jsonl}, {name: y, expect: g.jsonl}]"
    assert "golden file g.jsonl is that of another case, too" in parse_error(text)


def test_word_in_place_of_expectations_is_no_golden_file() -> None:
    text = "rules: a <- b.\ncases: [{name: x, expect: none}]"
    assert "expected expectations, or the path of a golden file that ends with .jsonl" in parse_error(text)


def test_folded_rules_and_merge_keys_are_errors() -> None:
    assert "write | in place of >" in parse_error("rules: >\n  a <- b.\ncases: [{name: x, expect: {}}]")
    assert "merge keys (<<) are not supported" in parse_error("cases:\n  - <<: {name: x}\n    expect: {}")


def test_schema_allows_none_for_warnings_and_errors() -> None:
    properties = make_json_schema()["definitions"]["expectations"]["properties"]
    assert {"const": "none"} in properties["warnings"]["oneOf"]
    assert properties["errors"]["oneOf"] == properties["warnings"]["oneOf"]


def test_file_with_byte_order_mark_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "tests" / "a.yaml"
    path.parent.mkdir()
    path.write_bytes(b"\xef\xbb\xbfcases: [{name: x, rules: a <- b., expect: {}}]\n")
    assert not is_foreign_file(path)
    assert [case.name for case in read_case_file(path)] == ["x"]


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ("input: [{event: b, interval: [-5, -3]}]", "interval: the end is before the start of the case"),
        ("start: 1e200", "start: 1e200 is too large: expected at most 3294967296"),
        ("start: -1", "start: -1 is too small: expected at least 0"),
    ],
)
def test_times_outside_of_range_are_errors(keys: str, problem: str) -> None:
    assert problem in parse_error(f"rules: a <- b.\ncases: [{{name: x, expect: {{}}, {keys}}}]")
