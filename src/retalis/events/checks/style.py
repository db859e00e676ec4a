"""Labels that two rules have, and variables that stand alone."""

from typing import Any, Dict, Iterator, Set

from ...foundation import RuleError
from ...prolog.terms import Var, deref, term_key
from .overview import Overview
from .written import WrittenRule, held, inners


def labels(program: Overview) -> Iterator[RuleError]:
    """Yield the rules whose label another has already."""
    first: Dict[Any, WrittenRule] = {}
    for rule in program.rules:
        label = rule.definition.label
        if label is None:
            continue
        other = first.setdefault(term_key(label), rule)
        if other is not rule:
            place = other.definition.place
            where = "" if place is None else f" (line {place.line})"
            name = program.logic.brief(label)
            yield RuleError(
                f"another rule{where} has the label {name}, too: windows and del_event_rule mean both",
                rule.definition.place,
            )


def singletons(program: Overview) -> Iterator[RuleError]:
    """Yield the variables that stand once in a rule, clause or goal and have a name."""
    for read in program.reads:
        wanted: Set[Var] = {read.names[name] for name in read.singletons}
        if not wanted:
            continue
        names = {var: name for name, var in read.names.items()}
        for inner in inners(held(read.term), 1, read.place_of):
            term: Any = deref(inner.term)
            if term.__class__ is Var and term in wanted:
                wanted.discard(term)
                name = names[term]
                yield RuleError(
                    f"{name} stands here only: a misspelt name? Otherwise write _{name} or _", inner.place
                )
