"""Golden files: reading, writing, and comparison with the outputs of a case."""

from pathlib import Path

import pytest
from testing.case_texts import FEVER_GOALS, FEVER_INPUT, FEVER_RULES, indent, run_text

from retalis import Definitions
from retalis.testing.golden_file import read_golden_file, write_golden_file
from retalis.testing.yaml_documents import CaseFileError

CASE = (
    f"rules: |\n{indent(FEVER_RULES, 2)}goals: |\n{indent(FEVER_GOALS, 2)}"
    f"cases:\n  - name: fever\n    input:\n{indent(FEVER_INPUT, 6)}    expect: golden.jsonl\n"
)

LINES = (
    '{"time": 3, "topic": "alarms", "id": "a", "output": "ill(ann)"}',
    '{"time": 4, "topic": "alarms", "id": "a", "output": "ill(bob)"}',
)


def test_result_has_lines_of_golden_file(definitions: Definitions, tmp_path: Path) -> None:
    result = run_text(CASE, definitions, tmp_path / "x_test.yaml")
    assert result.golden_lines == LINES
    assert result.failures == (
        f"{tmp_path}/x_test.yaml:11: there is no golden file {tmp_path}/golden.jsonl: "
        "retalis test --update writes it",
    )


def test_written_file_is_equal(definitions: Definitions, tmp_path: Path) -> None:
    write_golden_file(tmp_path / "golden.jsonl", LINES)
    assert run_text(CASE, definitions, tmp_path / "x_test.yaml").failures == ()


def test_difference_is_listed(definitions: Definitions, tmp_path: Path) -> None:
    write_golden_file(tmp_path / "golden.jsonl", [LINES[0], LINES[1].replace("bob", "carl")])
    (failure,) = run_text(CASE, definitions, tmp_path / "x_test.yaml").failures
    assert "  -    4.000 s  alarms  ill(carl)" in failure
    assert "  +    4.000 s  alarms  ill(bob)" in failure


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("{", "not a line of JSON"),
        ("[]", "expected an object with the fields time, topic, id and output"),
        ('{"time": "3", "topic": "a", "output": "b"}', "field 'time': expected a float"),
        ('{"time": 3, "topic": 4, "output": "b"}', "field 'topic': expected a str"),
        ('{"time": 3, "topic": "a", "output": "b", "id": 4}', "field 'id': expected a str or null"),
    ],
)
def test_invalid_line_is_an_error_with_place(line: str, error: str, tmp_path: Path) -> None:
    path = tmp_path / "golden.jsonl"
    path.write_text(f"{LINES[0]}\n{line}\n")
    with pytest.raises(CaseFileError, match=error) as raised:
        list(read_golden_file(path))
    assert raised.value.place is not None
    assert (raised.value.place.source, raised.value.place.line) == (str(path), 2)


def test_unwritable_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CaseFileError, match=r"cannot write .*/file/golden\.jsonl"):
        write_golden_file(tmp_path / "file" / "golden.jsonl", LINES)
