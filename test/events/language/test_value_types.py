"""Value types, their members, and disjoint types."""

import pytest
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
def test_a_value_is_of_its_kinds_and_no_others(value):
    kinds = [*VALUE_TYPES, "std_msgs__0__Empty", "std_msgs__0__Bool"]
    found = [name for name in kinds if parse_value_type(parse_term(name)).accepts(parse_term(value))]
    assert sorted(found) == sorted(VALUES[value].split())


@pytest.mark.parametrize("one", VALUE_TYPES)
@pytest.mark.parametrize("other", VALUE_TYPES)
def test_kinds_exclude_each_other_where_no_value_is_of_both(one, other):
    both = [value for value, kinds in VALUES.items() if {one, other} <= set(kinds.split()) and value != "nan"]
    assert VALUE_TYPES[one].excludes(VALUE_TYPES[other]) == (not both)
    assert VALUE_TYPES[one].excludes(VALUE_TYPES[other]) == VALUE_TYPES[other].excludes(VALUE_TYPES[one])


def test_every_form_is_one_that_terms_or_stamps_have():
    forms = {form_of(parse_term(value)) for value in VALUES} | {"stamp"}
    assert frozenset().union(*(kind.forms for kind in (*VALUE_TYPES.values(), *SLOT_TYPES.values()))) == forms


def test_messages_of_two_types_exclude_each_other():
    one, other = (parse_value_type(parse_term(f"std_msgs__0__{name}")) for name in ("Bool", "Empty"))
    assert one.excludes(other) and not one.excludes(one) and not one.excludes(VALUE_TYPES["event"])


def test_lists_in_lists():
    assert parse_value_type(parse_term("list(list(atom))")).items.items is VALUE_TYPES["atom"]


@pytest.mark.parametrize(
    "kind, said",
    [
        ("nubmer", "there is no type nubmer; did you mean number?"),
        ("text", "there is no type text: a type is any, atom, "),
        ("list(atm)", "there is no type atm; did you mean atom?"),
        ("f(x)", "a type is any, atom, "),
        ("_", "a type is any, atom, "),
        ("list(" * 20 + "atom" + ")" * 20, "a type is any, atom, "),
    ],
)
def test_what_is_no_kind(kind, said):
    with pytest.raises(UsageError) as caught:
        parse_value_type(parse_term(kind))
    assert caught.value.message.startswith(said)
