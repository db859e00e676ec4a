"""Checks of the names of variables: those that occur once, and constants that were probably meant as variables."""

from collections import deque
from typing import Any, Dict, Iterator, List, Set, Tuple

from ...foundation.errors import RuleError
from ...messages.type_definition import Definition
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.terms.types import (
    Atom,
    Functor,
    Term,
    Var,
    deref,
)
from ..language.pattern_parser import no_place
from ..language.pattern_tree import EventPattern, walk
from ..language.rule_heads import event_raised_by
from .condition_checks import NUMERIC_COMPARISONS
from .program_model import (
    ProgramModel,
    SourceRule,
    Subterm,
    subterms,
    wrap_term,
)


def find_singletons(program: ProgramModel) -> Iterator[RuleError]:
    """Yield variables without a leading ``_`` that occur once in a rule, clause or goal."""
    for read_term in program.read_terms:
        unreported: Set[Var] = {read_term.names[name] for name in read_term.singletons}
        if not unreported:
            continue
        names = {var: name for name, var in read_term.names.items()}
        for subterm in subterms(wrap_term(read_term.term), 1, read_term.place_of):
            term: Any = deref(subterm.term)
            if term.__class__ is Var and term in unreported:
                # The reader has counted one occurrence, so this is the only place.
                unreported.discard(term)
                name = names[term]
                text = _explain_variable_as_constant(program, name, subterm) or (
                    f"{name} occurs only here: a misspelt name? Otherwise write _{name} or _"
                )
                yield RuleError(text, subterm.place)


def _explain_variable_as_constant(program: ProgramModel, name: str, variable: Subterm) -> str:
    """Return the finding for a variable that was probably meant as a constant or as a bound value, or ""."""
    definition = program.message_of(variable.parent)
    matches = f"{name} is a variable, which matches every value"
    owner = None if definition is not None else program.derive(_messages_by_constant).get(name)
    if owner is not None:
        return f"{name} is a variable: for the constant of {owner.name} write {owner.functor_name}{{{name}}}"
    if variable.parent[0] in NUMERIC_COMPARISONS or variable.parent[0] in EVALUABLE:
        return (
            f"nothing binds {name}: a misspelt name? The start and the end of a match are S and E in "
            f"check (t1(S), t2(E), E - S > 1)"
        )
    if definition is not None:
        slot = definition.fields[variable.position - 1]
        for constant in definition.constants:
            if constant.name == name and not constant.problem:
                return (
                    f"{matches}: for the constant of {definition.name} write {{{name}}} in a named slot, "
                    f"{definition.functor_name}{{{name}}} elsewhere"
                )
        if slot.type == "bool" and name.lower() in ("true", "false"):
            return f"{matches}: write {name.lower()}"
    constants = program.derive(_constants_by_position)
    word = f"{name[:1].lower()}{name[1:]}"
    if len(name) > 1 and word in constants.get((variable.parent[0], variable.position), ()):
        return f"{matches}: for the constant write {word}; otherwise write _{name} or _"
    return ""


def _messages_by_constant(program: ProgramModel) -> Dict[str, Definition]:
    """Return the first message type with each constant, of the types in the program and in their slots."""
    # A dictionary, because it keeps the order of the program.
    types: Dict[str, Definition] = {}
    for subterm in program.all_subterms():
        definition = program.message_of(subterm.term)
        if definition is not None:
            types.setdefault(definition.name, definition)
    waiting = deque(types.values())
    messages: Dict[str, Definition] = {}
    while waiting:
        definition = waiting.popleft()
        for constant in definition.constants:
            if not constant.problem:
                messages.setdefault(constant.name, definition)
        for slot in definition.fields:
            if slot.definition is not None and slot.definition.name not in types:
                types[slot.definition.name] = slot.definition
                waiting.append(slot.definition)
    return messages


def find_constants_meant_as_variables(program: ProgramModel) -> Iterator[RuleError]:
    """Yield constants of a pattern that were probably meant as variables, such as m in ``hot(m) <- temp(m, T)``.

    Such a constant has one letter or the name of a variable at the same position of this event in another rule, is
    passed on to the head, and occurs in no other rule, goal or fact, which could give it to an event.
    """
    for rule in program.rules:
        head = event_raised_by(rule.definition.head)
        head_names = set() if head is None else {atom.term.name for atom in _constants_in(head)}
        reported: Set[str] = set()
        for node in walk(rule.definition.pattern) if head_names else ():
            if not isinstance(node, EventPattern) or program.message_of(node.term) is not None:
                continue
            for constant in _constants_in(node.term):
                name = constant.term.name
                if name in head_names and name not in reported and _is_unusual(program, rule, constant):
                    reported.add(name)
                    variable = f"{name[:1].upper()}{name[1:]}"
                    yield RuleError(
                        f"{name} is a constant, which only this rule has: the rule matches no event with another "
                        f"value; unless this is intended, write the variable {variable}",
                        rule.place_of(constant.parent, constant.position),
                    )


def _constants_in(term: Term) -> List[Subterm]:
    """Return the constants in the arguments of a term that are written like variables with a small letter."""
    return [
        subterm
        for subterm in subterms(wrap_term(term), 1, no_place)
        if isinstance(subterm.term, Atom)
        and subterm.term is not deref(term)
        and subterm.term.name.isidentifier()
        and subterm.term.name[:1].islower()
    ]


def _is_unusual(program: ProgramModel, rule: SourceRule, constant: Subterm) -> bool:
    """Return whether a constant of a pattern occurs only in its rule, in a position where others have variables."""
    name, position = constant.term.name, (constant.parent[0], constant.position)
    # Other constants at this position show that values are distinguished there.
    if program.derive(_constants_by_position).get(position, set()) != {name}:
        return False
    if program.derive(_rules_by_constant)[name] != {id(rule.definition.term)}:
        return False
    variable = f"{name[:1].upper()}{name[1:]}"
    return len(name) == 1 or variable in program.derive(_variables_by_position).get(position, ())


def _rules_by_constant(program: ProgramModel) -> Dict[str, Set[int]]:
    """Return the identities of the rules, clauses and goals that contain each constant."""
    sources: Dict[str, Set[int]] = {}
    roots = [(wrap_term(rule.definition.term), 1, rule.definition.term) for rule in program.rules]
    roots += [(clause.parent, clause.position, clause.parent) for clause in program.clauses]
    roots += [(wrap_term(clause.head), 1, clause.parent) for clause in program.clauses if clause.head]
    roots += [(goal.parent, goal.position, goal.parent) for goal in program.goals]
    roots += [(consumer.term, 1, consumer.term) for consumer in (*program.memories, *program.subscriptions)]
    for parent, position, root in roots:
        for subterm in subterms(parent, position, no_place):
            if isinstance(subterm.term, Atom):
                sources.setdefault(subterm.term.name, set()).add(id(root))
    return sources


def _variables_by_position(program: ProgramModel) -> Dict[Tuple[Functor, int], Set[str]]:
    """Return the names of the variables that rules write as arguments, by functor and position."""
    names: Dict[Tuple[Functor, int], Set[str]] = {}
    for rule in program.rules:
        names_of_rule = program.names_in(rule)
        for subterm in subterms(wrap_term(rule.definition.term), 1, no_place):
            if subterm.term.__class__ is Var and subterm.term in names_of_rule:
                position = (subterm.parent[0], subterm.position)
                names.setdefault(position, set()).add(names_of_rule[subterm.term])
    return names


def _constants_by_position(program: ProgramModel) -> Dict[Tuple[Functor, int], Set[str]]:
    """Return the names that the program writes as arguments, by functor and position."""
    constants: Dict[Tuple[Functor, int], Set[str]] = {}
    for subterm in program.all_subterms():
        if isinstance(subterm.term, Atom) and subterm.term.name[:1].islower():
            constants.setdefault((subterm.parent[0], subterm.position), set()).add(subterm.term.name)
    return constants
