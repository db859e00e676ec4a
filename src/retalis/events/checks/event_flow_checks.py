"""Checks of producers and consumers of events: events that never occur, are never used, or do not fit declarations.

Producers are topics, rule heads, timers, declared states, goals, facts ``input_event/1`` and the package itself;
consumers are rules, memories, subscriptions, states, facts such as ``external_trigger/1``, flags that log or store
all events, and observers of all events. If a goal creates events that cannot be determined statically, every event
counts as produced.
"""

from typing import Any, Dict, FrozenSet, Iterator, List, Optional, Sequence, Set

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...messages.type_definition import functor_name
from ...prolog.terms.types import SLASH, TRUE, Atom, Functor, Term, deref, functor, functor_of
from ..knowledge.knowledge_base import OWN_EVENTS
from ..language.called_predicates import calls
from ..language.event_declarations import (
    VariableTypes,
    calls_in_query,
    events_raised_by_goals,
    has_alternatives,
    head_event,
    slot_value_type,
)
from ..language.event_operators import ARROWS, OPERATOR_NAMES
from ..language.pattern_parser import EventTerm, PatternReader
from ..language.pattern_tree import ActionPattern, EventPattern, walk
from ..language.rule_heads import event_raised_by, makes_event
from ..language.state_parser import StateForm
from ..program.topic_configuration import TOPICS
from .program_model import (
    EventConsumer,
    FunctorSuggestions,
    ProgramModel,
    SourceRule,
    SourceTerm,
    is_variable,
    wrap_term,
)

_INPUT_EVENT = functor("input_event", 1)
SUBSCRIBE_TO = frozenset((functor("subscribe_to", 2), functor("subscribe_to", 3)))
_CONSUMER_FACTS = frozenset(
    functor(name, 1)
    for name in ("external_trigger", "print_trigger", "spy_event", "persistent_event", "persistent_rule")
)
_NO_EVENT = functor("null_event", 0)
_DISCARDED_EVENTS = frozenset((_NO_EVENT, functor("null", 0)))
_REV = functor("rev", 1)


class EventProducers:
    """Events that a program produces or receives.

    Attributes:
        places_by_functor: their functors, each with the place of a producer (None for topics).
        names_of_any_arity: event names of message types whose number of slots is unknown.
        has_unknown_events: whether some produced events cannot be determined statically; then every event counts as
            produced.
    """

    def __init__(self, program: ProgramModel):
        self.places_by_functor: Dict[Functor, Optional[Place]] = dict.fromkeys(OWN_EVENTS)
        self.names_of_any_arity: Set[str] = set()
        self.has_unknown_events = False
        self._add_topics(program)
        for rule in program.rules:
            head = event_raised_by(rule.definition.head)
            if head is not None:
                self._add_event(head, rule.definition.place)
        self._add_goal_events(program)
        for timer in program.rule_base.timers:
            self._add_event(timer.event, None)
        for state in program.states:
            self._add_event(state.form.state, None)
        for clause in program.clauses:
            if functor_of(clause.head) is _INPUT_EVENT:
                self.places_by_functor.update(dict.fromkeys(functors_in_fact(clause.head)))

    def __contains__(self, key: object) -> bool:
        """Return whether events of a functor are produced, or may be."""
        return (
            self.has_unknown_events
            or key in self.places_by_functor
            or getattr(key, "name", "") in self.names_of_any_arity
        )

    def _add_topics(self, program: ProgramModel) -> None:
        for topic in (*program.topics.subscribed, *program.directly_subscribed):
            name = program.topics.functor_name_of(topic)
            definition = program.definition(topic.type)
            # The number of slots is unknown, so every arity of the name is accepted.
            if definition is None:
                self.names_of_any_arity.add(name)
            else:
                self.places_by_functor[functor(name, len(definition.fields))] = None

    def _add_goal_events(self, program: ProgramModel) -> None:
        for subterm in program.all_subterms():
            term = subterm.term
            if makes_event(term):
                self._add_event(deref(term[1]), subterm.place)
            elif term.__class__ is tuple and term[0] in SUBSCRIBE_TO:
                self._add_subscribed_topic(program, [deref(argument) for argument in term[1:]])

    def _add_subscribed_topic(self, program: ProgramModel, arguments: Sequence[Term]) -> None:
        """Add the events of a topic that a goal subscribes to."""
        type_name, event = (getattr(argument, "name", None) for argument in (arguments[1], arguments[-1]))
        name = event if len(arguments) == 3 else type_name and functor_name(type_name)
        definition = program.definition(type_name)
        if name is None:
            self.has_unknown_events = True
        elif definition is None:
            self.names_of_any_arity.add(name)
        else:
            self.places_by_functor.setdefault(functor(name, len(definition.fields)))

    def _add_event(self, term: Term, place: Optional[Place]) -> None:
        key = functor_of(term)
        if key is None:
            self.has_unknown_events = self.has_unknown_events or is_variable(term)
        elif key is not _NO_EVENT:
            self.places_by_functor.setdefault(key, place)


def functors_in_fact(head: Any) -> Iterator[Functor]:
    """Yield the functors that a fact names, by ``Name/Arity`` or an event pattern."""
    term: Any = deref(head[1])
    if term.__class__ is tuple and term[0] is SLASH:
        name, arity = deref(term[1]), deref(term[2])
        if isinstance(name, Atom) and isinstance(arity, int):
            yield functor(name.name, arity)
        return
    key = functor_of(term)
    if key is not None:
        yield key


def find_unproduced_events(program: ProgramModel) -> Iterator[RuleError]:
    """Yield awaited events without a producer."""
    producers = EventProducers(program)
    suggestions = FunctorSuggestions()
    # Without topics, the program is probably fed by another one, through texts or the Python API: then only misspelt
    # names are reported.
    may_be_fed_externally = not (program.topics.subscribed or program.topics.published)
    reported: Set[Functor] = set()
    heads = _heads_by_event(program)
    for subterm, prefix in program.patterns():
        key = subterm.key
        if key is None or key in producers or key in reported or key is _NO_EVENT:
            continue
        # ``rev(E)`` occurs whenever events E are retracted, so it needs a producer of E only.
        if key is _REV and functor_of(subterm.term[1]) in producers:
            continue
        type_name = program.type_of(key.name)
        if type_name is not None and (
            program.definition(type_name) is None or _has_wrong_arity(program, type_name, key)
        ):
            # Errors in messages are reported by `find_message_mismatches`.
            continue
        reported.add(key)
        # The head of the rule that awaits the event is no misspelt event.
        own_heads = heads.get(key, ())
        candidates = [producer for producer in producers.places_by_functor if producer not in own_heads]
        suggestion = suggestions.suggest(key, candidates)
        if type_name is not None:
            yield RuleError(f"{prefix}{_explain_missing_topic(program, key, type_name)}", subterm.place)
        elif program.logic.is_system_predicate(key):
            yield RuleError(
                f"{prefix}no producer of {key}: {key} is a built-in predicate, and a goal is written after where; "
                f"if it is an event of another program, add the fact input_event({key}).",
                subterm.place,
            )
        elif suggestion or not may_be_fed_externally:
            yield RuleError(f"{prefix}{_explain_missing_producer(key, suggestion)}", subterm.place)


def _heads_by_event(program: ProgramModel) -> Dict[Functor, Set[Functor]]:
    """Return the heads of the rules and states that await an event, for each event."""
    heads: Dict[Functor, Set[Functor]] = {}
    for rule in program.rules:
        head = event_raised_by(rule.definition.head)
        head_key = None if head is None else functor_of(head)
        for node in walk(rule.definition.pattern, negated=True):
            key = functor_of(node.term) if isinstance(node, EventPattern) else None
            if key is not None and head_key is not None:
                heads.setdefault(key, set()).add(head_key)
    for state in program.states:
        for event in _events_of_state(state.form):
            key = functor_of(event.term)
            if key is not None:
                heads.setdefault(key, set()).add(state.form.functor)
    return heads


def _has_wrong_arity(program: ProgramModel, type_name: str, key: Functor) -> bool:
    definition = program.definition(type_name)
    return definition is not None and len(definition.fields) != key.arity


def _explain_missing_topic(program: ProgramModel, key: Functor, type_name: str) -> str:
    topics_of_type = [topic for topic, topic_type in program.topics.subscribed if topic_type == type_name]
    if topics_of_type:
        topic = topics_of_type[0]
        return f"no producer of {key}: the events of topic {topic} are called {program.event_name_of(topic)}"
    element = f'<subscribe_to name="..." msg_type="{type_name}"/>'
    return f"no producer of {key}: no topic of that type is subscribed; {element} in {TOPICS} subscribes one"


def _explain_missing_producer(key: Functor, suggestion: str) -> str:
    advice = f"; if another program sends it, add the fact input_event({key})."
    hint = f"; did you mean {suggestion}?" if suggestion else advice
    return f"no producer of {key}: no topic, rule or goal{hint}"


def explain_missing_producer(program: ProgramModel, pattern: Term) -> str:
    """Return a warning if an event pattern has no producer, else "".

    Variables, messages, ``null_event`` and ``rev/1`` get no warning.
    """
    key = functor_of(pattern)
    if key is None or key is _NO_EVENT or key is _REV or program.type_of(key.name) is not None:
        return ""
    producers = EventProducers(program)
    return (
        ""
        if key in producers
        else _explain_missing_producer(key, FunctorSuggestions().suggest(key, producers.places_by_functor))
    )


def find_unconsumed_events(program: ProgramModel) -> Iterator[RuleError]:
    """Yield produced events without a consumer."""
    # An observer, such as a recording or a callback for all events, consumes everything.
    consumed_functors = None if program.has_observer else _consumed_functors(program)
    if consumed_functors is None:
        return
    suggestions = FunctorSuggestions()
    reported: Set[Functor] = set()
    for rule in program.rules:
        head = event_raised_by(rule.definition.head)
        key = None if head is None else functor_of(head)
        if (
            head is None
            or key is None
            or key in consumed_functors
            or key in reported
            or key in _DISCARDED_EVENTS
            or key is _REV
        ):
            continue
        # A rule with ``do`` exists for its goal; its event may be unused.
        if isinstance(rule.definition.pattern, ActionPattern):
            continue
        reported.add(key)
        place = rule.place_of(head) if deref(head).__class__ is tuple else rule.definition.place
        yield RuleError(_explain_missing_consumer(key, consumed_functors, suggestions), place)
    for subterm in program.all_subterms():
        term = subterm.term
        if makes_event(term) and term[0].name != "event":
            key = functor_of(term[1])
            if key is not None and key not in consumed_functors and key not in reported:
                reported.add(key)
                yield RuleError(_explain_missing_consumer(key, consumed_functors, suggestions), subterm.place)


def _explain_missing_consumer(
    key: Functor, consumed_functors: FrozenSet[Functor], suggestions: FunctorSuggestions
) -> str:
    suggestion = suggestions.suggest(key, consumed_functors)
    hint = f"; did you mean {suggestion}?" if suggestion else ": no rule, memory or subscription"
    return f"no consumer of {key}{hint}"


def _consumed_functors(program: ProgramModel) -> Optional[FrozenSet[Functor]]:
    """Return the functors of all consumed events, or None if a consumer accepts all events."""
    consumed_functors: Set[Functor] = set()
    for subterm, _ in program.patterns():
        if subterm.key is None:
            return None
        consumed_functors.add(subterm.key)
        if subterm.key is _REV:
            consumed_functors.update(filter(None, [functor_of(subterm.term[1])]))
    for clause in program.clauses:
        if functor_of(clause.head) in _CONSUMER_FACTS:
            functors = list(functors_in_fact(clause.head))
            if not functors:
                return None
            consumed_functors.update(functors)
    flags = program.rule_base.flags
    # These flags log or store all events.
    if any(flags.is_on(name) for name in ("store_fired_events", "logging")):
        return None
    return frozenset(consumed_functors)


def find_declaration_violations(program: ProgramModel) -> Iterator[RuleError]:
    """Yield terms that do not fit the declarations of events."""
    declarations = program.declarations
    # Without declarations, the rules need not be parsed again.
    for rule in program.rules if declarations else ():
        variable_types = VariableTypes(program.names_in(rule), not has_alternatives(rule.definition.term))
        yield from declarations.find_errors(events_of_rule(rule), rule.place_of, variable_types)
    for source_term in (*program.clauses, *program.goals) if declarations else ():
        variable_types = VariableTypes(program.names, not has_alternatives(source_term.parent))
        yield from declarations.find_errors(
            events_of_goals(source_term), source_term.place_of, variable_types
        )
    for form, place_of, prefix in program.states if declarations else ():
        for error in declarations.find_errors(_events_of_state(form), place_of, VariableTypes(program.names)):
            yield RuleError(f"{prefix}{error.message}", error.place)
    for consumer in (*program.memories, *program.subscriptions) if declarations else ():
        for error in declarations.find_errors(
            [event_of_consumer(consumer)], consumer.place_of, VariableTypes({})
        ):
            yield RuleError(f"{consumer.prefix}{error.message}", error.place)
    yield from _find_topic_type_mismatches(program)


def _find_topic_type_mismatches(program: ProgramModel) -> Iterator[RuleError]:
    """Yield topics whose events have a declared name, but another number of slots or slots of other types."""
    for topic, type_name in program.topics.subscribed:
        declaration = program.declarations.get(program.event_name_of(topic))
        definition = program.definition(type_name)
        if declaration is None or definition is None:
            continue
        mismatch = program.declarations.functor_error(functor(declaration.name, len(definition.fields)))
        for slot, argument in zip(definition.fields, () if mismatch else declaration.arguments):
            slot_type = slot_value_type(slot)
            if slot_type is not None and slot_type.excludes(argument.value_type):
                mismatch = (
                    f"{argument.name} of {declaration.key} is {argument.value_type.description}, "
                    f"and {slot.name} of {type_name} {slot_type.description}"
                )
        if mismatch:
            yield RuleError(f"the events of topic {topic}: {mismatch}")


def _events_of_state(form: StateForm) -> List[EventTerm]:
    """Return the events of a declared state: that of its start, that of its end, and its own."""
    assert isinstance(form.term, tuple)
    state_events = [form.term, *[deref(side) for side in form.term[2:4]]]
    return [EventTerm(deref(side[1]), side, 1) for side in state_events if isinstance(side, tuple)]


def events_of_rule(rule: SourceRule) -> List[EventTerm]:
    """Return the events that a rule raises, awaits and creates by goals."""
    term = rule.definition.term
    assert term.__class__ is tuple
    # Parsed again with a reader that keeps places; its warnings were reported on loading.
    reader = PatternReader(rule.place_of, lambda warning: None)
    # A rule of the form ``Pattern do Goal`` has no arrow.
    if term[0] not in ARROWS:
        reader.read(wrap_term(term), 1)
        return [*reader.events, *events_raised_by_goals(reader.goals)]
    head = deref(term[1])
    if head.__class__ is tuple and OPERATOR_NAMES.get(head[0]) == "do":
        reader.read_goal(head, 2, "do")
    reader.read(term, 2)
    goals = [*reader.goals, *calls_in_query(rule.definition.head or TRUE)]
    return [head_event(term), *reader.events, *events_raised_by_goals(goals)]


def events_of_goals(goal: SourceTerm) -> List[EventTerm]:
    """Return the event patterns in the goals of a directive, goal file or clause."""
    return list(events_raised_by_goals(calls(goal.parent, goal.position)))


def event_of_consumer(consumer: EventConsumer) -> EventTerm:
    """Return the event pattern that a memory or subscription consumes."""
    event = consumer.event
    return EventTerm(event.term, event.parent, event.position)
