"""Values of YAML documents: conversion, places, and limits."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML
from ruamel.yaml.compat import StringIO

from retalis.testing import yaml_documents
from retalis.testing.yaml_documents import CaseFileError, parse_yaml

PLAIN_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(st.characters(min_codepoint=32, max_codepoint=126)),
    lambda values: (
        st.lists(values, max_size=4)
        | st.dictionaries(
            st.text(st.characters(min_codepoint=97, max_codepoint=122), min_size=1), values, max_size=4
        )
    ),
    max_leaves=12,
)


@given(PLAIN_VALUES)
def test_plain_value_is_that_of_the_writer(value: object) -> None:
    text = StringIO()
    YAML(typ="safe").dump({"value": value}, text)
    assert parse_yaml(text.getvalue(), "mine.yaml").plain() == {"value": value}


def test_words_of_older_yaml_are_texts() -> None:
    assert parse_yaml("[yes, no, on, off]", "mine.yaml").plain() == ["yes", "no", "on", "off"]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "mine.yaml: is empty: expected a mapping with the key 'cases'"),
        # The parsers of libyaml and of Python have other words, and name other columns.
        ("a: [1", "mine.yaml:[12]:[0-9]: not valid YAML: while parsing a flow sequence"),
        ("a: 1\n---\nb: 2", "mine.yaml:2:1: not valid YAML: expected a single document"),
        ("\tx: 1", "mine.yaml:1:1: not valid YAML"),
        ("[" * 4000, "mine.yaml.*: not valid YAML: "),
        ("a: *b", "mine.yaml:1:[0-9]: not valid YAML: found undefined alias"),
    ],
)
def test_invalid_document_is_an_error(text: str, error: str) -> None:
    with pytest.raises(CaseFileError, match=error):
        parse_yaml(text, "mine.yaml")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a: 1\na: 2", "mine.yaml:2:1: key 'a' is repeated"),
        ("b: 1", "mine.yaml:1:1: unknown key 'b': expected a or count"),
        ("cuont: 1", "mine.yaml:1:1: unknown key 'cuont': expected a or count; did you mean count?"),
        ("[1]", "mine.yaml:1:1: document: expected a mapping of a or count, found a list of 1 value"),
    ],
)
def test_mapping_accepts_its_keys_once(text: str, error: str) -> None:
    with pytest.raises(CaseFileError) as raised:
        parse_yaml(text, "mine.yaml").mapping({"a": 1, "count": 1})
    assert str(raised.value).splitlines()[0] == error


@pytest.mark.parametrize(
    ("method", "text", "error"),
    [
        ("number", "warm", "x: expected a number, found 'warm'"),
        ("number", "true", "x: expected a number, found 'true'"),
        ("number", ".inf", "x: expected a number, found '.inf'"),
        ("integer", "1.5", "x: expected an integer, found '1.5'"),
        ("integer", "-1", "x: -1 is too small: expected at least 0"),
        ("boolean", "yes", "x: expected true or false, found 'yes'"),
        ("text", "[1]", "x: expected a text, found a list of 1 value"),
        ("text", "", "x: expected a text, found nothing"),
        ("items", "{a: 1}", "x: expected a list, found a mapping of 1 key"),
        ("scalar", "!!binary aaaa", "x: expected a plain value, found 'aaaa'"),
    ],
)
def test_unexpected_value_is_an_error_with_its_place(method: str, text: str, error: str) -> None:
    value = parse_yaml(f"w: 1\nx: {text}", "mine.yaml").mapping()["x"]
    with pytest.raises(CaseFileError) as raised:
        getattr(value, method)()
    assert raised.value.message == error
    assert raised.value.place is not None
    assert raised.value.place.line == 2


def test_number_forms() -> None:
    assert parse_yaml("[0x1f, 0o17, 1_000, -3, 1e3, .5]", "mine.yaml").plain() == [
        31,
        15,
        1000,
        -3,
        1000.0,
        0.5,
    ]


def test_aliases_count_towards_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_documents, "MAX_VALUES", 1000)
    levels = ["a0: &a0 [1,1,1,1,1,1,1,1,1]"]
    levels += [f"a{level}: &a{level} [{','.join([f'*a{level - 1}'] * 9)}]" for level in range(1, 9)]
    with pytest.raises(CaseFileError, match="has more than 1000 values"):
        parse_yaml("\n".join(levels), "mine.yaml").plain()


def test_deep_nesting_is_an_error() -> None:
    with pytest.raises(CaseFileError, match="more than 60 nested values"):
        parse_yaml("[" * 70 + "]" * 70, "mine.yaml").plain()


@pytest.mark.parametrize(("text", "line"), [("a: |\n  first\n", 2), ("a: first", 1)])
def test_first_text_line_is_that_of_the_content(text: str, line: int) -> None:
    assert parse_yaml(text, "mine.yaml").mapping()["a"].first_text_line == line
