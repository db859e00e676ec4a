"""Whether a file is one of event rules, which is accepted or refused as a whole, or a Prolog program."""

import re
from typing import Callable, Optional, Tuple

from ...foundation import RetalisError, SyntaxFault
from ...prolog.logic import Logic
from ...prolog.syntax import OF_FILES, Program, read_program
from ...prolog.terms import Atom, Functor, Term, conjuncts, deref
from ..language import RULE, is_rule
from .clauses import DIRECTIVES, PROPERTY_FACT
from .included import included
from .reading import change_reading

_WORDS = re.compile(r"<-|'rule:'|'?\b(?:do|iff|IFF|event_rule_property|include)\b")
"""One of these is in each text that has event rules."""

_NAMES = re.compile(r"[:?]-\s*(?:\(\s*)?([a-z]\w*)")
"""What the directives of a text call first."""

_OF_LANGUAGE = frozenset(
    (
        "event", "declare_event", "new_event", "timer", "cancel_timer", "state", "delete_state",
        "memorize", "memorize_diactive", "delete_memory", "subscribe", "delete_subscription",
        "subscribe_to", "ins_event_rule", "del_event_rule", "del_all_event_rules",
        "compile_event_file", "compile_events", "compile_event_rules", "execute_event_stream_file",
        "fire_event_list", "fire_event_list_return_external_events", "set_etalis_flag", "reset_db",
        "reset_etalis", "reset_etalis_state",
    )
)  # fmt: skip
"""Goals of the event language that no Prolog program has."""

Opened = Callable[[Term], Optional[Tuple[str, str]]]
"""Gives the text of a file and what errors call it."""


def is_of_events(text: str, logic: Logic, opened: Opened) -> bool:
    """Tell whether a text has an event rule, or a directive that calls a predicate of the event language.

    Args:
        text: of the file.
        logic: knows predicates and operators.
        opened: gives the text of a file that this one includes, None where there is none.
    """
    if not _may_be(text):
        return False
    return _has_rules(read_program(text, logic.operators.copy(), flags=OF_FILES), logic, opened, 0)


def _may_be(text: str) -> bool:
    if _WORDS.search(text):
        return True
    return any(match.group(1) in _OF_LANGUAGE for match in _NAMES.finditer(text))


def _is_of_language(logic: Logic, key: Functor) -> bool:
    return key.name in _OF_LANGUAGE and logic.is_added(key)


_DEEPEST = 50
"""Files that include each other, at most."""


def _has_rules(program: Program, logic: Logic, opened: Opened, depth: int) -> bool:
    for read in program:
        if isinstance(read, SyntaxFault):
            if read.place is not None and "<-" in read.place.text:
                return True
            continue
        term = deref(read.term)
        if is_rule(term) or term.__class__ is tuple and (term[0] is PROPERTY_FACT or term[0] is RULE):
            return True
        if term.__class__ is not tuple or term[0] not in DIRECTIVES:
            continue
        name = included(term)
        if name is not None and depth < _DEEPEST:
            found = _text(name, opened)
            if found is not None:
                inner = read_program(found[0], program.operators, found[1], program.flags)
                if _has_rules(inner, logic, opened, depth + 1):
                    return True
                program.flags = inner.flags
            continue
        first = next(iter(conjuncts(term[1])))
        key = first[0] if first.__class__ is tuple else first.functor if isinstance(first, Atom) else None
        if key is not None and _is_of_language(logic, key):
            return True
        change_reading(term[1], program)
    return False


def _text(name: Term, opened: Opened) -> Optional[Tuple[str, str]]:
    try:
        return opened(name)
    except RetalisError:
        return None  # who reads the file in earnest says so
