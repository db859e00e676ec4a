"""Predicates that print messages and clauses, and enumerate properties of predicates.

Clauses are laid out as by SWI-Prolog's ``portray_clause/1``: one goal per line, control constructs in columns of four
characters, and variables named ``A``, ``B``, ... by their order. The text can be read back as the same clause.
"""

import logging
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, Iterator, List, Optional, Tuple

from ...foundation.displayed_text import shorten
from ..compiler.clause_nodes import ARROW, NOT, SEMICOLON, SOFT_ARROW
from ..database.predicate import Predicate
from ..machine.errors import ERROR, describe, indicator
from ..machine.machine import LAST
from ..syntax.operators import Operator, Operators
from ..syntax.term_writer import add_full_stop, named_message_portray, write_term
from ..terms.list_terms import list_items
from ..terms.term_traversal import copy
from ..terms.types import COMMA, SLASH, TRUE, Atom, Functor, String, Term, Var, atom, deref, functor
from .argument_checks import atom_of, indicator_of
from .builtin_registry import ProgramMachine, Solutions, deterministic, nondeterministic
from .output_predicates import format_to_text, make_variable_names, write_to

if TYPE_CHECKING:
    from ..database.clause_index import Clause

_NECK, _DIRECTIVE = functor(":-", 2), functor(":-", 1)
_FORMAT = functor("format", 2)
_LINE_OPTIONS: Dict[str, Any] = {"quoted": True, "numbervars": True, "spacing": True}
"""Options of the writer for a line of a clause."""

# Messages


@deterministic("print_message/2")
def print_message(machine: ProgramMachine, message_kind: Term, message: Term) -> bool:
    """Report a message: ``format(Format, Args)``, an error term, or any other term."""
    name = atom_of(message_kind).name
    # Messages of these kinds are not shown.
    if name in ("silent", "debug", "banner"):
        return True
    text = format_message(machine, deref(message))
    prefix = {"error": "ERROR: ", "warning": "Warning: "}.get(name, "")
    machine.logic.message(name, f"{prefix}{text}\n")
    return True


def format_message(machine: ProgramMachine, message: Term) -> str:
    """Return the text of a message."""
    if message.__class__ is tuple:
        if message[0] is _FORMAT:
            return format_to_text(machine, message[1], message[2])
        if message[0] is ERROR:
            return describe(message)
    if message.__class__ is String:
        return message.text
    return machine.logic.show(message)


@deterministic("print_message_lines/3")
def print_message_lines(machine: ProgramMachine, stream: Term, prefix: Term, lines: Term) -> bool:
    """Write the lines of a message: items ``Format-Args``, ``Format`` and ``nl``."""
    texts = []
    for line in list_items(lines) or []:
        line = deref(line)
        if line.__class__ is Atom and line.name == "nl":
            texts.append("\n")
        elif line.__class__ is tuple and line[0].name == "-":
            texts.append(format_to_text(machine, line[1], line[2]))
        else:
            texts.append(format_to_text(machine, line, atom("[]")))
    write_to(machine, stream, "".join(texts))
    return True


# Log

goal_log = logging.getLogger("retalis.goals")
"""Log of what goals log. A node forwards it to ROS, with the level of each record."""

MAX_LOGGED_CHARACTERS = 4_096
"""Maximum length of a logged text; longer ones are shortened."""


@deterministic("log_debug/2")
def log_debug(machine: ProgramMachine, text_format: Term, arguments: Term) -> bool:
    """Log a formatted text with the level DEBUG."""
    return _log(machine, logging.DEBUG, text_format, arguments)


@deterministic("log_info/2")
def log_info(machine: ProgramMachine, text_format: Term, arguments: Term) -> bool:
    """Log a formatted text with the level INFO."""
    return _log(machine, logging.INFO, text_format, arguments)


@deterministic("log_warn/2")
def log_warn(machine: ProgramMachine, text_format: Term, arguments: Term) -> bool:
    """Log a formatted text with the level WARNING."""
    return _log(machine, logging.WARNING, text_format, arguments)


@deterministic("log_error/2")
def log_error(machine: ProgramMachine, text_format: Term, arguments: Term) -> bool:
    """Log a formatted text with the level ERROR."""
    return _log(machine, logging.ERROR, text_format, arguments)


def _log(machine: ProgramMachine, level: int, text_format: Term, arguments: Term) -> bool:
    text = format_to_text(machine, text_format, arguments)
    goal_log.log(level, "%s", shorten(text, MAX_LOGGED_CHARACTERS))
    return True


# Listing


@deterministic("portray_clause/1")
def portray_clause(machine: ProgramMachine, term: Term) -> bool:
    """Write a clause with layout and named variables."""
    machine.logic.write(format_clause(machine, term))
    return True


@deterministic("portray_clause/2")
def portray_clause_to(machine: ProgramMachine, stream: Term, term: Term) -> bool:
    """Write a clause to a stream with layout and named variables."""
    write_to(machine, stream, format_clause(machine, term))
    return True


def format_clause(machine: ProgramMachine, term: Term) -> str:
    """Return the text of a clause, with one goal per line; variables are named A, B, ..., or ``_`` if single."""
    # The names are bound to variables of a copy, so that the clause itself is not changed.
    term = copy(term)
    names = make_variable_names(term)
    term = deref(term)
    operators = machine.logic.operators
    portray = named_message_portray(term, operators, **_LINE_OPTIONS, variable_names=names)
    layout = _BodyLayout(operators, names, portray)
    if any(operators.find(key.name) != standard for key, standard in _layout_operators()):
        # The layout assumes the standard priorities; with other ones the text would be read as a different term.
        layout.append(layout.format_term(term, 1199))
    elif term.__class__ is tuple and term[0] is _NECK and deref(term[2]) is not TRUE:
        layout.append(f"{layout.format_head(term[1])} :-\n    ")
        layout.append_body(term[2], 1)
    elif term.__class__ is tuple and term[0] is _NECK:
        layout.append(layout.format_term(term[1], 1199))
    elif term.__class__ is tuple and term[0] is _DIRECTIVE:
        layout.append(":- ")
        layout.append_body(term[1], 1)
    else:
        layout.append(layout.format_term(term, 1200 if term.__class__ is Atom else 1199))
    return add_full_stop(layout.join()) + "\n"


@lru_cache(maxsize=1)
def _layout_operators() -> List[Tuple[Functor, List[Operator]]]:
    """Return the operators that the layout depends on, with their standard definitions."""
    standard = Operators.prolog()
    keys = (_NECK, COMMA, SEMICOLON, ARROW, SOFT_ARROW, NOT)
    return [(key, standard.find(key.name)) for key in keys]


_MAX_LAYOUT_DEPTH = 40
"""Limit for the depth of control constructs that are written on several lines."""


class _BodyLayout:
    """Layout of a clause, with one goal per line and control constructs in columns.

    The priorities are those of Prolog's operators: 1200 for ``:-``, whose arguments have at most 1199, and 1000 for
    the comma, whose left argument has at most 999.

    Args:
        operators: operators of the program.
        names: names of the variables.
        portray: returns the text of a term that is not written as usual, or None.
    """

    def __init__(
        self,
        operators: Operators,
        names: Dict[Var, str],
        portray: Optional[Callable[[Term], Optional[str]]] = None,
    ):
        self._portray = portray
        self._operators = operators
        self._names = names
        self._parts: List[str] = []

    def append(self, text: str) -> None:
        """Append a text."""
        self._parts.append(text)

    def join(self) -> str:
        """Return the whole text."""
        return "".join(self._parts)

    def format_head(self, head: Term) -> str:
        """Return the text of a rule's head."""
        head = deref(head)
        # A prefix operator as head needs parentheses, or the neck would be read as its argument.
        is_prefix = head.__class__ is Atom and head.name in self._operators.prefix
        return f"({self.format_term(head, 1200)})" if is_prefix else self.format_term(head, 1199)

    def format_term(self, term: Term, priority: int) -> str:
        """Return a term on one line; an operator of a higher priority is put in parentheses, as by SWI-Prolog."""
        term = deref(term)
        if term.__class__ is Atom and any(
            operator.priority > priority for operator in self._operators.find(term.name)
        ):
            return f"({write_term(term, self._operators, **_LINE_OPTIONS)})"
        return write_term(
            term,
            self._operators,
            **_LINE_OPTIONS,
            priority=priority,
            variable_names=self._names,
            portray=self._portray,
        )

    def append_body(self, goal: Term, depth: int) -> None:
        """Append a body. Conjunctions are written iteratively, as they may have any length."""
        goal = deref(goal)
        while goal.__class__ is tuple and goal[0] is COMMA:
            self._append_argument(goal[1], depth)
            self.append(f",\n{'    ' * depth}")
            goal = deref(goal[2])
        # Deeper control constructs are written on one line, which limits the recursion.
        if (
            goal.__class__ is tuple
            and goal[0] in (SEMICOLON, ARROW, SOFT_ARROW)
            and depth < _MAX_LAYOUT_DEPTH
        ):
            self.append("(   ")
            self._append_branches(goal, depth)
            self.append(f"\n{'    ' * depth})")
        elif goal.__class__ is tuple and goal[0] is NOT and depth < _MAX_LAYOUT_DEPTH:
            self.append("\\+ ")
            self._append_argument(goal[1], depth)
        else:
            self.append(self.format_term(goal, 999))

    def _append_argument(self, goal: Term, depth: int) -> None:
        """Append a goal of a conjunction, or a negated one; a conjunction needs parentheses there."""
        goal = deref(goal)
        if goal.__class__ is not tuple or goal[0] is not COMMA:
            self.append_body(goal, depth)
        elif depth < _MAX_LAYOUT_DEPTH:
            self.append("(   ")
            self.append_body(goal, depth + 1)
            self.append(f"\n{'    ' * depth})")
        else:
            self.append(self.format_term(goal, 999))

    def _append_branches(self, goal: Term, depth: int) -> None:
        """Append the branches of a disjunction, or the single branch of a condition."""
        prefix = f"\n{'    ' * depth}"
        while goal.__class__ is tuple and goal[0] is SEMICOLON:
            self._append_branch(deref(goal[1]), depth, prefix)
            self.append(f"{prefix};   ")
            goal = deref(goal[2])
        self._append_branch(goal, depth, prefix)

    def _append_branch(self, goal: Term, depth: int, prefix: str) -> None:
        if goal.__class__ is tuple and goal[0] in (ARROW, SOFT_ARROW):
            self.append_body(goal[1], depth + 1)
            self.append(f"{prefix}{'->' if goal[0] is ARROW else '*->'}{'  ' if goal[0] is ARROW else ' '}")
            goal = deref(goal[2])
        self.append_body(goal, depth + 1)


@deterministic("listing/1")
def listing(machine: ProgramMachine, target: Term) -> bool:
    """Write the clauses of the predicates with a name or an indicator, or of a list of them."""
    target = deref(machine.logic.database.modules.resolve_declared_indicators(target))
    targets = list_items(target)
    for item in targets if targets is not None and target.__class__ is tuple else [target]:
        for predicate in _find_predicates(machine, deref(item)):
            _list_predicate(machine, predicate)
    return True


def _find_predicates(machine: ProgramMachine, target: Term) -> List[Predicate]:
    """Return the predicates with a name, or the predicate of an indicator."""
    database = machine.logic.database
    if target.__class__ is tuple and target[0] is SLASH and deref(target[2]).__class__ is not Var:
        key = indicator_of(target)
        return [database.predicate(key)] if key in database.predicates else []
    name = atom_of(target[1] if target.__class__ is tuple and target[0] is SLASH else target).name
    plain_functor_of = database.modules.plain_functor
    matches = [
        predicate
        for key, predicate in database.predicates.items()
        if key.name == name or (plain_functor_of(key) or key).name == name
    ]
    return sorted(matches, key=lambda predicate: predicate.functor.arity)


@deterministic("listing/0")
def listing_all(machine: ProgramMachine) -> bool:
    """Write all clauses of the program, without those of libraries."""
    predicates = list(machine.logic.database.predicates.values())
    # The hidden predicates of tabled ones are listed under the names of these.
    hidden = {predicate.hidden_predicate for predicate in predicates}
    for predicate in predicates:
        if not predicate.is_library_predicate and predicate not in hidden:
            _list_predicate(machine, predicate)
    return True


def _list_predicate(machine: ProgramMachine, predicate: Predicate) -> None:
    """Write the declarations and clauses of a predicate."""
    clause_owner = predicate.clause_owner
    # Predicates that are written in Python have no clauses.
    if clause_owner.kind != "user" and not clause_owner.dynamic:
        return
    logic = machine.logic
    modules = logic.database.modules
    key = modules.plain_functor(predicate.functor) or predicate.functor
    declarations = [("dynamic", clause_owner)] if clause_owner.dynamic else []
    # The clauses of a tabled predicate belong to a hidden one.
    if clause_owner is not predicate:
        declarations.append(("table", predicate))
    for declaration, declared_predicate in declarations:
        suffix = " as incremental" if declared_predicate.is_incremental else ""
        logic.write(f":- {declaration} {logic.show(indicator(key))}{suffix}.\n\n")
    for clause in clause_owner.active_clauses():
        logic.write(format_clause(machine, modules.display_form((_NECK, clause.head, clause.body))))
    logic.write("\n")


# Properties


@nondeterministic("predicate_property/2")
def predicate_property(machine: ProgramMachine, head: Term, prop: Term) -> Solutions:
    """Enumerate the properties of a predicate."""
    logic = machine.logic
    modules = logic.database.modules
    head = modules.resolve_searched_clause(head)
    if head.__class__ is Var:
        # The goal may define predicates between two solutions, so the table is copied.
        for key, predicate in list(logic.database.predicates.items()):
            if (
                not predicate.is_defined
                or predicate.is_library_predicate
                or modules.plain_functor(key) is not None
            ):
                continue
            most_general_head = (key, *[Var() for _ in range(key.arity)]) if key.arity else atom(key.name)
            for value in _properties(predicate):
                if machine.unify_all((head, most_general_head), (prop, value)):
                    yield None
        return
    key = head[0] if head.__class__ is tuple else atom_of(head).functor
    definition = logic.lookup(key)
    plain_key = modules.plain_functor(key)
    if definition is None and plain_key is not None:
        definition = logic.lookup(plain_key)
    for value in [] if definition is None else _properties(definition):
        if machine.unify(prop, value):
            yield None


def _properties(predicate: Predicate) -> Iterator[Term]:
    yield atom("defined")
    yield atom("visible")
    clause_owner = predicate.clause_owner
    yield atom("dynamic" if clause_owner.dynamic else "static")
    if predicate.is_library_predicate:
        yield atom("system" if predicate.is_protected else "library")
        if predicate.is_protected:
            yield atom("built_in")
    if clause_owner.kind != "user" and not clause_owner.dynamic:
        yield atom("foreign")
    else:
        clause_owner.report_read()
        yield (functor("number_of_clauses", 1), len(clause_owner))
    if clause_owner.discontiguous:
        yield atom("discontiguous")
    if clause_owner.multifile:
        yield atom("multifile")
    if predicate.is_incremental:
        yield atom("incremental")
    if predicate.hidden_predicate is not None:
        yield atom("tabled")
        for option in ("variant", "incremental") if predicate.is_incremental else ("variant",):
            yield (functor("tabled", 1), atom(option))


@nondeterministic("nth_clause/3")
def nth_clause(machine: ProgramMachine, head: Term, number: Term, reference: Term) -> Solutions:
    """Enumerate the clauses of a predicate with their numbers; the clause term is used as its reference."""
    head = deref(head)
    key = head[0] if head.__class__ is tuple else atom_of(head).functor
    predicate = machine.logic.lookup(key)
    clause_number = deref(number)
    clauses: Iterable[Clause] = ()
    if predicate is not None:
        predicate.clause_owner.report_read()
        clauses = predicate.clause_owner.active_clauses()
    for position, clause in enumerate(clauses, 1):
        # A known number selects a single clause, and leaves no choice point.
        if clause_number.__class__ is int and position != clause_number:
            continue
        if machine.unify_all((number, position), (reference, copy((_NECK, clause.head, clause.body)))):
            yield None if clause_number.__class__ is Var else LAST
