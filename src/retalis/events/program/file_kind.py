"""File kind: decision whether a file contains event rules or is a Prolog program, and reader settings of directives.

A file counts as an event file if it contains an event rule, or a directive that calls a predicate of the event
language. A regular expression excludes most Prolog files. For the others the terms are read, with the operators and
flags that their directives set, and included_file_name files are followed. Nothing is executed.
"""

import re
from typing import Any, Callable, List, Optional, Tuple

from ...foundation.errors import RetalisError, SyntaxFault
from ...prolog.syntax.term_reader import OF_FILES, Program, read_program
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import conjuncts, list_items
from ...prolog.terms.types import Atom, Functor, Term, deref, functor
from ..language.rule_head_parser import RULE, is_rule
from .event_file_checker import DIRECTIVES, PROPERTY_FACT, included_file_name

_OP = functor("op", 3)
_SET_FLAG = functor("set_prolog_flag", 2)


def apply_reader_settings(goal: Term, program: Program) -> None:
    """Apply operators and flags that a directive sets to the rest of the text."""
    for goal_part in conjuncts(goal):
        if goal_part.__class__ is not tuple:
            continue
        arguments = [deref(argument) for argument in goal_part[1:]]
        if goal_part[0] is _OP and arguments[0].__class__ is int and arguments[1].__class__ is Atom:
            for name in _operator_names(arguments[2]):
                try:
                    program.operators.add(arguments[0], arguments[1].name, name)
                except (RetalisError, ValueError):
                    # The directive itself reports the error when it runs.
                    continue
        elif goal_part[0] is _SET_FLAG and arguments[0].__class__ is Atom and arguments[1].__class__ is Atom:
            name = arguments[0].name
            if name in ("double_quotes", "back_quotes"):
                changed: Any = {name: arguments[1].name}
                program.flags = program.flags._replace(**changed)


def _operator_names(term: Term) -> List[str]:
    items = list_items(term)
    terms = [deref(item) for item in items] if items else [term]
    return [item.name for item in terms if item.__class__ is Atom]


_RULE_SIGNS = re.compile(r"<-|'rule:'|'?\b(?:do|iff|IFF|event_rule_property|include)\b")
"""Each text with event rules contains one of these."""

_DIRECTIVE_CALLS = re.compile(r"[:?]-\s*(?:\(\s*)?([a-z]\w*)")
"""The first predicate that a directive calls."""

_EVENT_PREDICATES = frozenset(
    (
        "event", "declare_event", "new_event", "timer", "cancel_timer", "state", "delete_state",
        "memorize", "memorize_diactive", "delete_memory", "subscribe", "delete_subscription",
        "subscribe_to", "ins_event_rule", "del_event_rule", "del_all_event_rules",
        "compile_event_file", "compile_events", "compile_event_rules", "execute_event_stream_file",
        "fire_event_list", "fire_event_list_return_external_events", "set_etalis_flag", "reset_db",
        "reset_etalis", "reset_etalis_state",
    )
)  # fmt: skip
"""Predicates of the event language that no Prolog program uses."""

Opened = Callable[[Term], Optional[Tuple[str, str]]]
"""A function that returns the text of a file and its name for errors; None if there is no such file."""


def is_event_file(text: str, logic: PrologSystem, opened: Opened) -> bool:
    """Return whether a text contains an event rule, or a directive that calls a predicate of the event language.

    Args:
        text: text of the file.
        logic: provides predicates and operators.
        opened: returns the text of an included_file_name file.
    """
    if not _may_have_rules(text):
        return False
    return _has_rules(read_program(text, logic.operators.copy(), flags=OF_FILES), logic, opened, 0)


def _may_have_rules(text: str) -> bool:
    if _RULE_SIGNS.search(text):
        return True
    return any(match.group(1) in _EVENT_PREDICATES for match in _DIRECTIVE_CALLS.finditer(text))


def _is_event_predicate(logic: PrologSystem, key: Functor) -> bool:
    return key.name in _EVENT_PREDICATES and logic.is_added(key)


_MAX_INCLUDE_DEPTH = 50
"""Maximum depth of included files."""


def _has_rules(program: Program, logic: PrologSystem, open_included: Opened, depth: int) -> bool:
    for read_term in program:
        if isinstance(read_term, SyntaxFault):
            # A rule with a syntax error must not turn the file into a Prolog program, where it would only be a
            # warning.
            if read_term.place is not None and "<-" in read_term.place.text:
                return True
            continue
        term = deref(read_term.term)
        if is_rule(term) or term.__class__ is tuple and (term[0] is PROPERTY_FACT or term[0] is RULE):
            return True
        if term.__class__ is not tuple or term[0] not in DIRECTIVES:
            continue
        name = included_file_name(term)
        if name is not None and depth < _MAX_INCLUDE_DEPTH:
            included_file = _text_of_included(name, open_included)
            if included_file is not None:
                inner = read_program(included_file[0], program.operators, included_file[1], program.flags)
                if _has_rules(inner, logic, open_included, depth + 1):
                    return True
                program.flags = inner.flags
            continue
        goal = next(iter(conjuncts(term[1])))
        key = goal[0] if goal.__class__ is tuple else goal.functor if isinstance(goal, Atom) else None
        if key is not None and _is_event_predicate(logic, key):
            return True
        apply_reader_settings(term[1], program)
    return False


def _text_of_included(name: Term, open_included: Opened) -> Optional[Tuple[str, str]]:
    try:
        return open_included(name)
    except RetalisError:
        # Reading the file later reports the error.
        return None
