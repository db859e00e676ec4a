"""All that is known of a program when it has been loaded, for the checks."""

from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation import MessageError, UsageError
from ...messages import Definition, Definitions, type_name
from ...prolog.logic import Logic
from ...prolog.syntax import ReadTerm
from ...prolog.terms import CompoundTerm, Term, Var, deref, functor, term_key
from ..knowledge import Knowledge, is_whole
from ..language import (
    SPELLINGS,
    Occurs,
    Spot,
    StateForm,
    calls,
    declares_state,
    own_terms,
    state_form,
    subscribed_event,
    walk,
)
from ..program import Topics, TopicType
from ..rules import Rules
from .written import Inner, Written, WrittenRule, WrittenTerm, clause_at, everywhere, held, inners, read_again

MEMORIZE = frozenset((functor("memorize", 5), functor("memorize", 6), functor("memorize_diactive", 5)))
SUBSCRIBE = functor("subscribe", 5)


class Kept(NamedTuple):
    """A memory or a subscription.

    Attributes:
        term: ``(Functor, Pattern, Conditions, Form, Id or Topic, Size or Id)``.
        who: what to call it where its place is not known.
        spot: gives the places of its parts.
    """

    term: CompoundTerm
    who: str
    spot: Spot

    @property
    def pattern(self) -> Term:
        """The events that it takes."""
        found: Term = self.event.term
        return found

    @property
    def event(self) -> Inner:
        """The same in its place, which may be within ``P with S``."""
        whole = deref(self.term[1])
        event = subscribed_event(whole) if self.term[0] is SUBSCRIBE else whole
        return Inner(event, self.term if event is whole else _compound(whole), 1, self.spot)

    @property
    def form(self) -> Term:
        """The term that it makes of them, as written."""
        return deref(self.term[3])

    @property
    def stands_for_event(self) -> bool:
        """True if the form is a variable of its own, as ``_``: then the event itself is recorded or sent."""
        return is_whole(self.pattern, deref(self.term[2]), self.form)

    @property
    def made(self) -> Term:
        """The term that it makes of an event: the form, or the event itself."""
        return self.pattern if self.stands_for_event else self.form


class DeclaredAt(NamedTuple):
    """A state, what gives the places of its parts, and what to call it where these are not known."""

    form: StateForm
    spot: Spot
    who: str


class Overview:
    """A program that has been loaded, and its files.

    Args:
        rules: of the program.
        knowledge: its memories and subscriptions.
        definitions: the message types that are known.
        topics: what ``pub_sub.xml`` says.
        direct: topics that node retalis subscribes by itself.
        folder: the program's; None where only what is loaded is looked at.
        observed: whether somebody looks at all events.
    """

    def __init__(
        self,
        rules: Rules,
        knowledge: Knowledge,
        definitions: Definitions,
        topics: Topics,
        direct: Tuple[TopicType, ...] = (),
        folder: Optional[Path] = None,
        observed: bool = False,
    ):
        self.loaded = rules
        self.logic: Logic = rules.logic
        self._renamed = {
            topics.event_of(topic): kind for topic, kind in topics.subscribed if topics.event_of(topic)
        }
        self.definitions = definitions
        self.topics = topics
        self.direct = direct
        self.folder = folder
        self.observed = observed
        files = Written([], [], [], [], set())
        if folder is not None:
            files = read_again(self.logic, folder, rules.files.loaded)
        self.reads: List[ReadTerm] = files.reads
        self.names: Dict[Var, str] = {var: name for read in files.reads for name, var in read.names.items()}
        self.goals: List[WrittenTerm] = files.goals
        self.rules = [*files.rules, *_other_rules(rules, files.sources)]
        self.clauses = [*files.clauses, *_other_clauses(self.logic, files.sources)]
        self.declared = rules.declared.now()
        self.memories: List[Kept] = []
        self.subscriptions: List[Kept] = []
        self.states: List[DeclaredAt] = []
        self._keep(knowledge)
        self._note_states(knowledge)
        self._types: Dict[str, Optional[Definition]] = {}

    def definition(self, kind: Optional[str]) -> Optional[Definition]:
        """Return the definition of a message type, where it is known."""
        if kind is None:
            return None
        if kind not in self._types:
            try:
                self._types[kind] = self.definitions.find(kind)
            except MessageError:
                self._types[kind] = None
        return self._types[kind]

    def event_of(self, topic: str) -> str:
        """Return what the events of a topic are called where it is not by its type, else ""."""
        return self.topics.event_of(topic)

    def type_of(self, name: str) -> Optional[str]:
        """Return the message type of the events of a name; None where they are no messages."""
        return type_name(name) or self._renamed.get(name)

    def message_of(self, term: Any) -> Optional[Definition]:
        """Return the definition of the message that a compound term is, where it has all of its slots."""
        found = self.definition(self.type_of(term[0].name)) if term.__class__ is tuple else None
        return found if found is not None and len(found.fields) == len(term) - 1 else None

    def patterns(self) -> Iterator[Tuple[Inner, str]]:
        """Yield the events that are waited for, and who waits where no place is known."""
        for rule in self.rules:
            term = rule.definition.term
            own = list(
                inners(_of_rule(rule), 1, rule.spot)
                if rule.definition.head is None or term.__class__ is not tuple
                else inners(term, 2, rule.spot)
            )
            for node in walk(rule.definition.pattern, negated=True):
                if isinstance(node, Occurs):
                    yield _found(own, deref(node.term), rule.spot), ""
        for kept in (*self.memories, *self.subscriptions):
            yield kept.event, kept.who
        for form, spot, who in self.states:
            for part in map(deref, _compound(form.term)[2:4]):
                parent = _compound(part)
                yield Inner(deref(parent[1]), parent, 1, spot), who

    def called(self) -> Iterator[Inner]:
        """Yield what goals call: those of files, bodies of clauses, and goals of rules."""
        goals = [(one.parent, one.number, one.spot) for one in (*self.goals, *self.clauses)]
        for rule in self.rules:
            for part in walk(rule.definition.pattern, negated=True):
                if not isinstance(part, Occurs):
                    goals += [(held(goal), 1, rule.spot) for goal in own_terms(part)]
        for parent, number, spot in goals:
            for call in calls(parent, number):
                yield Inner(call.term, call.parent, call.number, spot)

    def calls(self) -> Iterator[Inner]:
        """Yield all terms that goals of the program are, or have in them."""
        for one in (*self.goals, *self.clauses):
            yield from inners(one.parent, one.number, one.spot)
        for rule in self.rules:
            yield from inners(_of_rule(rule), 1, rule.spot)

    def _keep(self, knowledge: Knowledge) -> None:
        """Note memories and subscriptions: those that stand in the files, and others that are there."""
        seen: Set[Tuple[str, Any]] = set()
        for inner in self.calls():
            term = inner.term
            if term.__class__ is not tuple or (term[0] not in MEMORIZE and term[0] is not SUBSCRIBE):
                continue
            if inner.key is SUBSCRIBE:
                self.subscriptions.append(Kept(term, "", inner.spot))
                seen.add((self.topic(term[4]), term_key(deref(term[5]))))
            else:
                self.memories.append(Kept(term, "", inner.spot))
                seen.add(("", term_key(deref(term[4]))))
        for instance in knowledge.memories:
            if ("", term_key(instance.id)) not in seen:
                who = f"memory {self.logic.brief(instance.id)}: "
                self.memories.append(Kept(_compound(instance.definition), who, everywhere(None)))
        for (topic, _), one in knowledge.subscriptions.items():
            if (topic, term_key(one.id)) not in seen:
                who = f"a subscription of topic {topic}: "
                self.subscriptions.append(Kept(_compound(one.definition), who, everywhere(None)))

    def _note_states(self, knowledge: Knowledge) -> None:
        """Note the states that the files declare, and others that are there."""
        seen = set()
        for inner in self.calls():
            if declares_state(inner.term):
                try:
                    form = state_form(inner.term)
                except UsageError:  # said where it is declared
                    continue
                self.states.append(DeclaredAt(form, inner.spot, ""))
                seen.add(form.key)
        for one in knowledge.states:
            if one.form.key not in seen:
                self.states.append(DeclaredAt(one.form, everywhere(None), f"{one.name}: "))

    def topic(self, term: Term) -> str:
        """Return the topic that a subscription names, as text."""
        topic: Any = deref(term)
        return str(topic.name) if hasattr(topic, "name") else self.logic.show(topic, quoted=False)


def _compound(term: Any) -> CompoundTerm:
    found: CompoundTerm = term
    return found


def _of_rule(rule: WrittenRule) -> CompoundTerm:
    return held(rule.definition.term)


def _found(own: List[Inner], term: Term, spot: Spot) -> Inner:
    """Return a term of a rule with its place; copies in repetitions have that of the rule."""
    same = [inner for inner in own if inner.term is term]
    # an atom may stand in a goal before, too: the event is the one that operators join
    joined = [inner for inner in same if inner is own[0] or inner.parent[0] in SPELLINGS]
    found = joined or same
    return found[0] if found else Inner(term, held(term), 1, spot)


def _other_rules(rules: Rules, sources: Set[str]) -> List[WrittenRule]:
    """Return the rules that stand in no file that was read."""
    return [
        WrittenRule(rule.definition, everywhere(rule.place))
        for rule in rules.rules
        if rule.place is None or rule.place.source not in sources
    ]


def _other_clauses(logic: Logic, sources: Set[str]) -> List[WrittenTerm]:
    """Return the clauses of the program that stand in no file that was read."""
    found = []
    for predicate in list(logic.database.predicates.values()):
        if predicate.kind == "user" and not predicate.library:
            for clause in predicate.live():
                if clause.place is None or clause.place.source not in sources:
                    found.append(clause_at(clause.head, clause.body, clause.place))
    return found


def is_open(term: Term) -> bool:
    """Tell whether a term is a variable."""
    return deref(term).__class__ is Var
