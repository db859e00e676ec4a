"""Event rules that others add and delete while the program runs."""

from itertools import count
from typing import Any

from ..events.language import RULE, is_rule, labelled
from ..foundation import UsageError
from ..prolog.syntax import ReadTerm, read_term
from ..prolog.terms import Atom, Term, atom, deref, term_key
from .asking import do_for_others
from .core import parts_of
from .engine import Engine
from .ownfiles import REQUEST

_NEW = "added_"
"""How the label of a rule begins that was given none."""


def add_rule(engine: Engine, text: str, label: str = "") -> str:
    """Add one event rule, with the checks of an event file; return the label by which `delete_rule` knows it.

    Args:
        engine: takes it.
        text: the rule.
        label: its label; by default its own, or a new one.

    Raises:
        SyntaxFault: for a text that is not a term.
        ProgramErrors: what else is wrong in it, each with its place.
        UsageError: for what is no rule, and for a label that is taken.
    """
    read = read_term(text, engine.operators, "rule")
    term: Any = deref(read.term)
    if not is_rule(term):
        raise UsageError("expected one event rule, as in Head <- Pattern")

    def work() -> str:
        name = _label(engine, read, label)
        parts_of(engine).rules.loader.load_read(read)
        return engine.show(name)

    return do_for_others(engine, work)


def _label(engine: Engine, read: ReadTerm, wanted: str) -> Term:
    """Return the label of a rule that was read, which is given one where it has none."""
    term: Any = deref(read.term)
    own, _ = labelled(term)
    name = _named(engine, wanted) if wanted.strip() else own
    if own is not None and wanted.strip() and _name_of(own) is not name:
        raise UsageError(f"label: the rule has the label {engine.brief(_name_of(own))} already")
    taken = {
        term_key(_name_of(rule.label)) for rule in parts_of(engine).rules.rules if rule.label is not None
    }
    if name is None:
        name = next(one for one in map(_numbered, count(1)) if term_key(one) not in taken)
    if term_key(_name_of(name)) in taken:
        raise UsageError(f"a rule {engine.brief(_name_of(name))} already exists")
    if own is None:
        read.term = RULE(name, term)
    return _name_of(name)


def delete_rule(engine: Engine, label: str) -> None:
    """Delete the event rules with a label, and what waits in them.

    Raises:
        UsageError: where there are none.
    """
    name = _named(engine, label)
    if not engine.do(lambda: parts_of(engine).rules.delete(name), REQUEST):
        raise UsageError(f"there is no rule {engine.brief(name)}")


def _named(engine: Engine, text: str) -> Term:
    """Return the label that a text is."""
    if not text.strip():
        raise UsageError("label is empty")
    name = deref(read_term(text, engine.operators, "label").term)
    if not isinstance(name, Atom):
        raise UsageError(f"label: expected an atom, found {engine.brief(name)}")
    return name


def _numbered(number: int) -> Term:
    return atom(f"{_NEW}{number}")


def _name_of(label: Any) -> Term:
    """Return a label without its properties."""
    return label if isinstance(label, Atom) else atom(label[0].name)
