"""Value types, their members, and disjoint types."""

from typing import Any

import pytest
from asserting_accessors import required
from parsing import parse_term

from retalis import UsageError
from retalis.events.language.event_declarations import SLOT_TYPES, VALUE_TYPES, form_of, parse_value_type

VALUES = {
    "left": "any atom event",
    "'\"left\"'": "any atom string event",
    '"left"': "any string",
    "3": "any number integer time",
    "3.5": "any number float time",
    "nan": "any atom number float event",
    "[]": "any list",
    "[1, 2]": "any list time",
    "[a, B]": "any list time",
    "[a, b]": "any list",
    "f(x)": "any event",
    "datime(2026,1,2,3,4,5,6)": "any time event",
    "datime(2026,1,2,3,4,5,X)": "any time event",
    "datime(2026,13,2,3,4,5,6)": "any event",
    "std_msgs__0__Empty": "any atom event std_msgs__0__Empty",
    "std_msgs__0__Bool(true)": "any event std_msgs__0__Bool",
}


@pytest.mark.parametrize("value", VALUES)
def test_value_is_accepted_by_its_types_only(value: str) -> None:
    type_names = [*VALUE_TYPES, "std_msgs__0__Empty", "std_msgs__0__Bool"]
    accepting_types = [
        name for name in type_names if parse_value_type(parse_term(name)).accepts(parse_term(value))
    ]
    assert sorted(accepting_types) == sorted(VALUES[value].split())


@pytest.mark.parametrize("first", VALUE_TYPES)
@pytest.mark.parametrize("second", VALUE_TYPES)
def test_types_without_common_value_exclude_each_other(first: Any, second: Any) -> None:
    common_values = [
        value
        for value, type_names in VALUES.items()
        if {first, second} <= set(type_names.split()) and value != "nan"
    ]
    assert VALUE_TYPES[first].excludes(VALUE_TYPES[second]) == (not common_values)
    assert VALUE_TYPES[first].excludes(VALUE_TYPES[second]) == VALUE_TYPES[second].excludes(
        VALUE_TYPES[first]
    )


def test_forms_of_types_are_forms_of_terms() -> None:
    forms = {form_of(parse_term(value)) for value in VALUES} | {"stamp"}
    assert (
        frozenset().union(*(value_type.forms for value_type in (*VALUE_TYPES.values(), *SLOT_TYPES.values())))
        == forms
    )


def test_message_types_exclude_each_other() -> None:
    first, second = (parse_value_type(parse_term(f"std_msgs__0__{name}")) for name in ("Bool", "Empty"))
    assert first.excludes(second)
    assert not first.excludes(first)
    assert not first.excludes(VALUE_TYPES["event"])


def test_list_types_may_be_nested() -> None:
    assert (
        required(required(parse_value_type(parse_term("list(list(atom))"))).items).items
        is VALUE_TYPES["atom"]
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nubmer", "there is no type nubmer; did you mean number?"),
        ("text", "there is no type text: a type is any, atom, "),
        ("list(atm)", "there is no type atm; did you mean atom?"),
        ("f(x)", "a type is any, atom, "),
        ("_", "a type is any, atom, "),
        ("list(" * 20 + "atom" + ")" * 20, "a type is any, atom, "),
    ],
)
def test_unknown_type_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_value_type(parse_term(text))
    assert caught.value.message.startswith(message)
