import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_terms import names, shape, terms

from retalis.prolog.syntax import Operators, ReadFlags, read_term, to_text, write_term
from retalis.prolog.terms import Functor, atom

EVENT = ReadFlags(event_text=True)


def operator_tables():
    kinds = st.sampled_from(["xfx", "xfy", "yfx", "fy", "fx", "xf", "yf"])
    priorities = st.sampled_from([1, 100, 200, 200, 400, 500, 500, 700, 900, 999, 1000, 1001, 1150, 1200])
    usable = names.filter(lambda name: name not in (",", "|", "[]", "{}"))
    return st.lists(st.tuples(priorities, kinds, usable), max_size=12).map(_table)


def _table(entries):
    operators = Operators.prolog()
    for priority, kind, name in entries:
        if not (name in operators.infix and kind in ("xf", "yf")):  # ISO 13211-1, 8.14.3.3 forbids both
            operators.add(priority, kind, name)
        if kind in ("xfx", "xfy", "yfx"):
            operators.postfix.pop(name, None)
    return operators


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(terms, operator_tables())
def test_write_then_read(term, operators):
    for text in (
        write_term(term, operators),
        write_term(term, operators, spacing=True),
        write_term(term, operators, wide=True),
        write_term(term, operators, ignore_ops=True),
        write_term(term, operators, priority=999),
    ):
        assert shape(read_term(text, operators).term) == shape(term), text


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(terms)
def test_event_text_reads_back(term):
    """Strings excepted: in event text, ``"a"`` is the atom with the quotes inside."""
    read = read_term(to_text(term), Operators.prolog(), flags=EVENT).term
    expected = [_as_atom(item) for item in shape(term)]
    assert list(shape(read)) == expected


def _as_atom(item):
    is_string = not isinstance(item, Functor) and item[0] == "String"
    return ("Atom", atom(f'"{item[1].text}"')) if is_string else item
