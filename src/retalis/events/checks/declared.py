"""What does not fit the declarations of events, and was read before them."""

from typing import Iterator, List

from ...foundation import RuleError
from ...prolog.terms import TRUE, deref, functor
from ..language import (
    ARROWS,
    SPELLINGS,
    EventTerm,
    PatternReader,
    StateForm,
    VariableKinds,
    calls,
    has_branches,
    head_event,
    made_by_goals,
    query_goals,
    slot_kind,
)
from .overview import Kept, Overview
from .written import WrittenRule, WrittenTerm, held


def unfitting(program: Overview) -> Iterator[RuleError]:
    """Yield what does not fit."""
    declared = program.declared
    for rule in program.rules if declared else ():
        kinds = VariableKinds(
            {**program.names, **rule.definition.names}, not has_branches(rule.definition.term)
        )
        yield from declared.misfits(events_of_rule(rule), rule.spot, kinds)
    for one in (*program.clauses, *program.goals) if declared else ():
        kinds = VariableKinds(program.names, not has_branches(one.parent))
        yield from declared.misfits(events_of_goals(one), one.spot, kinds)
    for form, spot, who in program.states if declared else ():
        for error in declared.misfits(_events_of_state(form), spot, VariableKinds(program.names)):
            yield RuleError(f"{who}{error.message}", error.place)
    for kept in (*program.memories, *program.subscriptions) if declared else ():
        for error in declared.misfits([event_of_kept(kept)], kept.spot, VariableKinds({})):
            yield RuleError(f"{kept.who}{error.message}", error.place)
    yield from _unfitting_topics(program)


def _unfitting_topics(program: Overview) -> Iterator[RuleError]:
    """Yield the topics whose events have a name of their own, and are declared otherwise."""
    for topic, kind in program.topics.subscribed:
        one = program.declared.get(program.event_of(topic))
        definition = program.definition(kind)
        if one is None or definition is None:
            continue
        wrong = program.declared.wrong_functor(functor(one.name, len(definition.fields)))
        for slot, argument in zip(definition.fields, () if wrong else one.arguments):
            found = slot_kind(slot)
            if found is not None and found.excludes(argument.kind):
                both = f"{argument.kind.what}, and {slot.name} of {kind} {found.what}"
                wrong = f"{argument.name} of {one.key} is {both}"
        if wrong:
            yield RuleError(f"the events of topic {topic}: {wrong}")


def _events_of_state(form: StateForm) -> List[EventTerm]:
    """Return the events of a state: that with which it begins, that with which it ends, and its own."""
    assert isinstance(form.term, tuple)
    sides = [form.term, *[deref(side) for side in form.term[2:4]]]
    return [EventTerm(deref(side[1]), side, 1) for side in sides if isinstance(side, tuple)]


def events_of_rule(rule: WrittenRule) -> List[EventTerm]:
    """Return the events that a rule fires, waits for and makes by goals."""
    term = rule.definition.term
    assert term.__class__ is tuple
    reader = PatternReader(rule.spot, lambda warning: None)
    if term[0] not in ARROWS:  # P do G
        reader.read(held(term), 1)
        return [*reader.events, *made_by_goals(reader.goals)]
    head = deref(term[1])
    if head.__class__ is tuple and SPELLINGS.get(head[0]) == "do":
        reader.goal(head, 2, "do")
    reader.read(term, 2)
    goals = [*reader.goals, *query_goals(rule.definition.head or TRUE)]
    return [head_event(term, 1), *reader.events, *made_by_goals(goals)]


def events_of_goals(one: WrittenTerm) -> List[EventTerm]:
    """Return the events that a goal, or the body of a clause, makes."""
    return list(made_by_goals(calls(one.parent, one.number)))


def event_of_kept(kept: Kept) -> EventTerm:
    """Return the events that a memory or subscription takes."""
    event = kept.event
    return EventTerm(event.term, event.parent, event.number)
