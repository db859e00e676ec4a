"""Which events a program makes, and which it takes.

What does not fit the declarations of events, and was read before them.
"""

from typing import Any, Dict, FrozenSet, Iterator, List, Optional, Sequence, Set

from ...foundation.errors import Place, RuleError
from ...messages.type_definition import functor_name
from ...prolog.terms.types import SLASH, TRUE, Atom, Functor, Term, deref, functor
from ..knowledge.knowledge_base import OWN_EVENTS
from ..language.event_declarations import (
    VariableKinds,
    has_branches,
    head_event,
    made_by_goals,
    query_goals,
    slot_kind,
)
from ..language.goal_analysis import calls
from ..language.pattern_operators import ARROWS, SPELLINGS
from ..language.pattern_parser import EventTerm, PatternReader
from ..language.pattern_tree import Action
from ..language.rule_parser import made_by, makes_event
from ..language.state_parser import StateForm
from ..program.program_folder import TOPICS
from .program_model import Kept, NearFunctors, ProgramModel, WrittenRule, WrittenTerm, held, is_open, key_of

_OUTSIDE = functor("input_event", 1)
SUBSCRIBE_TO = frozenset((functor("subscribe_to", 2), functor("subscribe_to", 3)))
_SHOWN = frozenset(
    functor(name, 1)
    for name in ("external_trigger", "print_trigger", "spy_event", "persistent_event", "persistent_rule")
)
_NO_EVENT = functor("null_event", 0)
_FOR_NOBODY = frozenset((_NO_EVENT, functor("null", 0)))
_REV = functor("rev", 1)


class EventProducers:
    """The events that a program makes or gets: of topics, heads, goals and other programs.

    Attributes:
        keys: their functors, each with the place where one is made (None for those of topics).
        names: of message types whose number of slots is not known.
        anything: whether events are made that cannot be seen.
    """

    def __init__(self, program: ProgramModel):
        self.keys: Dict[Functor, Optional[Place]] = dict.fromkeys(OWN_EVENTS)
        self.names: Set[str] = set()
        self.anything = False
        self._topics(program)
        for rule in program.rules:
            head = made_by(rule.definition.head)
            if head is not None:
                self._note(head, rule.definition.place)
        self._goals(program)
        for timer in program.loaded.timers:
            self._note(timer.event, None)
        for state in program.states:
            self._note(state.form.state, None)
        for clause in program.clauses:
            if key_of(clause.head) is _OUTSIDE:
                self.keys.update(dict.fromkeys(_named(clause.head)))

    def __contains__(self, key: object) -> bool:
        return self.anything or key in self.keys or getattr(key, "name", "") in self.names

    def _topics(self, program: ProgramModel) -> None:
        for topic, kind in (*program.topics.subscribed, *program.direct):
            name = program.event_of(topic) or functor_name(kind)
            definition = program.definition(kind)
            if definition is None:
                self.names.add(name)
            else:
                self.keys[functor(name, len(definition.fields))] = None

    def _goals(self, program: ProgramModel) -> None:
        hidden = False
        others: Set[Functor] = set()
        for inner in program.calls():
            term = inner.term
            if inner.key is not None:
                others.add(inner.key)
            if makes_event(term):
                made: Any = deref(term[1])
                hidden = hidden or is_open(made)
                self._note(made, inner.place)
            elif term.__class__ is tuple and term[0] in SUBSCRIBE_TO:
                self._subscribed(program, [deref(one) for one in term[1:]])
        if hidden:  # a goal makes what it is given: whatever the program names may be that
            self.keys.update({key: None for key in others if key not in self.keys})

    def _subscribed(self, program: ProgramModel, arguments: Sequence[Term]) -> None:
        """Note the events of a topic that a goal subscribes, where the goal says which."""
        kind, event = (getattr(one, "name", None) for one in (arguments[1], arguments[-1]))
        name = event if len(arguments) == 3 else kind and functor_name(kind)
        definition = program.definition(kind)
        if name is None:
            self.anything = True
        elif definition is None:
            self.names.add(name)
        else:
            self.keys.setdefault(functor(name, len(definition.fields)))

    def _note(self, term: Term, place: Optional[Place]) -> None:
        key = key_of(term)
        if key is None:
            self.anything = self.anything or is_open(term)
        elif key is not _NO_EVENT:
            self.keys.setdefault(key, place)


def _named(head: Any) -> Iterator[Functor]:
    """Yield what a fact names: ``Name/Arity`` or a pattern of events."""
    term: Any = deref(head[1])
    if term.__class__ is tuple and term[0] is SLASH:
        name, arity = deref(term[1]), deref(term[2])
        if isinstance(name, Atom) and isinstance(arity, int):
            yield functor(name.name, arity)
        return
    key = key_of(term)
    if key is not None:
        yield key


def never_made(program: ProgramModel) -> Iterator[RuleError]:
    """Yield what is waited for and never comes."""
    made = EventProducers(program)
    nearby = NearFunctors()
    from_outside = not (program.topics.subscribed or program.topics.published)
    seen: Set[Functor] = set()
    for inner, who in program.patterns():
        key = inner.key
        if key is None or key in made or key in seen or key is _NO_EVENT:
            continue
        if key is _REV and key_of(inner.term[1]) in made:
            continue
        kind = program.type_of(key.name)
        if kind is not None and (program.definition(kind) is None or _wrong_slots(program, kind, key)):
            continue  # said by the check of messages
        seen.add(key)
        nearest = nearby.of(key, made.keys)
        if kind is not None:
            yield RuleError(f"{who}{_no_topic(program, key, kind)}", inner.place)
        elif nearest or not from_outside:
            yield RuleError(f"{who}{_nothing(key, nearest)}", inner.place)


def _wrong_slots(program: ProgramModel, kind: str, key: Functor) -> bool:
    definition = program.definition(kind)
    return definition is not None and len(definition.fields) != key.arity


def _no_topic(program: ProgramModel, key: Functor, kind: str) -> str:
    renamed = [topic for topic, one in program.topics.subscribed if one == kind]
    if renamed:
        return (
            f"nothing makes {key}: the events of topic {renamed[0]} are called {program.event_of(renamed[0])}"
        )
    element = f'<subscribe_to name="..." msg_type="{kind}"/>'
    return f"nothing makes {key}: no topic of that type is subscribed; {element} in {TOPICS} subscribes one"


def _nothing(key: Functor, nearest: str) -> str:
    hint = f"; did you mean {nearest}?" if nearest else ""
    return (
        f"nothing makes {key}: no topic, rule or goal{hint or '; if other programs send it, say so'}"
        f"{'' if hint else f' with the fact input_event({key}).'}"
    )


def without_maker(program: ProgramModel, pattern: Term) -> str:
    """Return that nothing makes the events of a pattern, "" where something does or they are messages."""
    key = key_of(pattern)
    if key is None or key is _NO_EVENT or key is _REV or program.type_of(key.name) is not None:
        return ""
    made = EventProducers(program)
    return "" if key in made else _nothing(key, NearFunctors().of(key, made.keys))


def never_taken(program: ProgramModel) -> Iterator[RuleError]:
    """Yield what is made and goes nowhere."""
    taken = None if program.observed else _taken(program)
    if taken is None:
        return
    nearby = NearFunctors()
    seen: Set[Functor] = set()
    for rule in program.rules:
        head = made_by(rule.definition.head)
        key = None if head is None else key_of(head)
        if head is None or key is None or key in taken or key in seen or key in _FOR_NOBODY or key is _REV:
            continue
        if isinstance(rule.definition.pattern, Action):  # it is there for what it does
            continue
        seen.add(key)
        place = rule.spot(head) if deref(head).__class__ is tuple else rule.definition.place
        yield RuleError(_nobody(key, taken, nearby), place)
    for inner in program.calls():
        term = inner.term
        if makes_event(term) and term[0].name != "event":
            key = key_of(term[1])
            if key is not None and key not in taken and key not in seen:
                seen.add(key)
                yield RuleError(_nobody(key, taken, nearby), inner.place)


def _nobody(key: Functor, taken: FrozenSet[Functor], nearby: NearFunctors) -> str:
    nearest = nearby.of(key, taken)
    hint = f"; did you mean {nearest}?" if nearest else ": no rule, memory or subscription"
    return f"nothing takes {key}{hint}"


def _taken(program: ProgramModel) -> Optional[FrozenSet[Functor]]:
    """Return the functors of all events that somebody takes; None where somebody takes all."""
    found: Set[Functor] = set()
    for inner, _ in program.patterns():
        if inner.key is None:
            return None
        found.add(inner.key)
        if inner.key is _REV:
            found.update(filter(None, [key_of(inner.term[1])]))
    for clause in program.clauses:
        if key_of(clause.head) in _SHOWN:
            named = list(_named(clause.head))
            if not named:
                return None
            found.update(named)
    flags = program.loaded.flags
    if any(flags.is_on(name) for name in ("store_fired_events", "logging")):
        return None
    return frozenset(found)


def unfitting(program: ProgramModel) -> Iterator[RuleError]:
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


def _unfitting_topics(program: ProgramModel) -> Iterator[RuleError]:
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
