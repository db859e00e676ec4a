"""Model of a loaded program for the static checks, with source positions.

Loaded rules and clauses do not keep the places of their subterms. `parse_sources_again` therefore parses the files of
the program a second time and keeps rules, clauses and goals together with functions that return places
(`PlaceLookup`). Definitions without a source file, for example clauses asserted at run time, are taken from the
loaded program; of these, only the place of the start is known, if any. As in the rest of the package, the *key* of a
term, event or predicate is its functor.

`FunctorSuggestions` finds similar names for "did you mean" hints within a bounded time.
"""

import os
from collections import ChainMap
from contextlib import nullcontext
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    TypeVar,
    Union,
)

from ...foundation.errors import MessageError, SyntaxFault, UsageError
from ...foundation.similar_names import MAX_CANDIDATES, closest_name
from ...foundation.source_places import Place
from ...messages.type_definition import Definition, type_name
from ...messages.type_registry import Definitions
from ...prolog.syntax.term_reader import OF_FILES, ReadTerm, read_program
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import term_key, variables
from ...prolog.terms.types import (
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    String,
    Term,
    Var,
    deref,
    functor,
    functor_of,
)
from ..knowledge.knowledge_base import KnowledgeBase
from ..knowledge.memory import is_event_variable
from ..language.called_predicates import calls
from ..language.event_operators import OPERATOR_NAMES
from ..language.pattern_parser import PlaceLookup, no_place
from ..language.pattern_tree import EventPattern, RuleDefinition, own_terms, walk
from ..language.state_parser import StateForm, declares_state, parse_state_declaration
from ..language.stream_parser import subscription_event
from ..program.event_file_parser import EntryKind, EventFileParser
from ..program.goal_file import goal_of, read_goals
from ..program.topic_configuration import GOALS, Topics, TopicType, read_text
from ..rules.rule_base import RuleBase

Analysis = TypeVar("Analysis")

MIN_SIMILARITY = 0.66
"""Minimum similarity of a name of a program or topic that is suggested."""

MAX_COMPARISONS = 40_000
"""Maximum number of comparisons of names per check; takes about a second."""


class FunctorSuggestions:
    """Search for similar functors, with a limit for the total work."""

    def __init__(self) -> None:
        self._comparisons_left = MAX_COMPARISONS

    def suggest(self, key: Functor, keys: Iterable[Functor]) -> str:
        """Return a functor with the same or the most similar name and the nearest arity, or ""."""
        candidates = list(keys)
        same_name = [
            candidate for candidate in candidates if candidate.name == key.name and candidate is not key
        ]
        if not same_name:
            names = list(dict.fromkeys(candidate.name for candidate in candidates))[:MAX_CANDIDATES]
            self._comparisons_left -= len(names)
            name = closest_name(key.name, names, MIN_SIMILARITY) if self._comparisons_left >= 0 else ""
            same_name = [candidate for candidate in candidates if candidate.name == name]
        return (
            str(min(same_name, key=lambda candidate: abs(candidate.arity - key.arity))) if same_name else ""
        )


MAX_SOURCE_CHARACTERS = 1 << 20
"""Maximum length of a file that is parsed again; for longer ones, only places of whole rules are known."""

_MAX_FILES = 100

NECK = functor(":-", 2)
_GRAMMAR = functor("-->", 2)
_WRAPPER = functor("$goal", 1)
_INCLUDE = functor("include", 1)
_LOAD_GOALS = frozenset(
    functor(name, 1)
    for name in ("compile_event_file", "compile_events", "consult", "ensure_loaded", "use_module")
)


class SourceRule(NamedTuple):
    """Rule with a function for the places of its parts."""

    definition: RuleDefinition
    place_of: PlaceLookup


class SourceTerm(NamedTuple):
    """Clause, or goal of a goal file or directive.

    Attributes:
        head: the head of a clause; None for a goal.
        parent: term with the body as argument ``position``.
        place_of: returns the places of its parts.
        place: the place where it starts.
    """

    head: Optional[Term]
    parent: CompoundTerm
    position: int
    place_of: PlaceLookup
    place: Optional[Place]


class Subterm(NamedTuple):
    """Subterm: argument ``position`` of ``parent``."""

    term: Any
    parent: CompoundTerm
    position: int
    place_of: PlaceLookup

    @property
    def place(self) -> Optional[Place]:
        """The place where it starts, or that of the operator for an operator term."""
        if self.term.__class__ is tuple:
            return self.place_of(self.term)
        return self.place_of(self.parent, self.position)

    @property
    def key(self) -> Optional[Functor]:
        """The functor of an atom or compound term, or None."""
        return functor_of(self.term)


def subterms(parent: CompoundTerm, position: int, place_of: PlaceLookup) -> Iterator[Subterm]:
    """Yield an argument of a term and all its subterms, from left to right."""
    stack = [Subterm(deref(parent[position]), parent, position, place_of)]
    while stack:
        subterm = stack.pop()
        yield subterm
        term = subterm.term
        if term.__class__ is tuple:
            stack += [
                Subterm(deref(term[index]), term, index, place_of) for index in range(len(term) - 1, 0, -1)
            ]


def wrap_term(term: Term) -> CompoundTerm:
    """Wrap a term, so that it can be addressed as argument 1 of a parent."""
    return (_WRAPPER, term)


def operator_place(rule: SourceRule, operator: str) -> Optional[Place]:
    """Return the place of the first occurrence of an operator in a rule."""
    for subterm in subterms(wrap_term(rule.definition.term), 1, rule.place_of):
        if subterm.term.__class__ is tuple and OPERATOR_NAMES.get(subterm.term[0]) == operator:
            return subterm.place
    return rule.definition.place


class ParsedSources(NamedTuple):
    """Contents of the files of a program, with places; ``paths`` are the files that were parsed."""

    rules: List[SourceRule]
    clauses: List[SourceTerm]
    goals: List[SourceTerm]
    read_terms: List[ReadTerm]
    paths: Set[str]


def parse_sources_again(logic: PrologSystem, folder: Path, loaded_paths: Iterable[Path]) -> ParsedSources:
    """Parse the files of a program again.

    Args:
        logic: provides the operators.
        folder: the folder of the program.
        loaded_paths: real paths of the loaded files; files that goals name are parsed even if they were not loaded.
    """
    sources = ParsedSources([], [], [], [], set())
    real_folder = Path(os.path.realpath(folder))
    goal_files = [folder / GOALS]
    # `_add_goals` appends the files that a goal file includes.
    for path in goal_files:
        _add_goals(sources, goal_files, path, logic)
    read_paths = {os.path.realpath(path) for path in goal_files}
    paths = [
        *_files_loaded_by(sources.goals, folder),
        *sorted(_path_as_written(path, real_folder, folder) for path in loaded_paths),
    ]
    for path in paths:
        if os.path.realpath(path) not in read_paths:
            read_paths.add(os.path.realpath(path))
            text = _read_short_text(path)
            if text:
                sources.paths.add(str(path))
                _add_file(sources, read_program(text, logic.operators.copy(), str(path), OF_FILES))
    return sources


def _path_as_written(path: Path, real_folder: Path, folder: Path) -> Path:
    """Return a real path relative to the folder as given, as the goals of the program write it."""
    try:
        return folder / path.relative_to(real_folder)
    except ValueError:
        return path


def _files_loaded_by(goals: Iterable[SourceTerm], folder: Path) -> Iterator[Path]:
    """Yield the files that goals load, in order."""
    for goal in goals:
        for subterm in subterms(goal.parent, goal.position, goal.place_of):
            if subterm.term.__class__ is tuple and subterm.key in _LOAD_GOALS:
                name = _file_name(deref(subterm.term[1]))
                if name and os.path.isfile(folder / name):
                    yield folder / name


def _file_name(name: Any) -> str:
    """Return the text of an atom or string as a file name, or ""."""
    text = name.name if name.__class__ is Atom else name.text if name.__class__ is String else ""
    # A null character would raise an error in the functions of `os.path`.
    return "" if "\0" in text else text


def _read_short_text(path: Path) -> str:
    try:
        text = read_text(path)
    except UsageError:
        # Reported when the file was loaded.
        return ""
    return text if len(text) <= MAX_SOURCE_CHARACTERS else ""


def _add_goals(sources: ParsedSources, files: List[Path], path: Path, logic: PrologSystem) -> None:
    for read_term in read_goals(_read_short_text(path), logic.operators, str(path)):
        if not isinstance(read_term, ReadTerm):
            continue
        goal: Any = goal_of(read_term.term)
        if goal.__class__ is tuple and goal[0] is _INCLUDE:
            included = path.parent / (_file_name(deref(goal[1])) or path.name)
            # The caller iterates over this list while it grows, so included files are read as well. Each file is
            # added once, so files that include each other end the iteration.
            if included not in files and len(files) < _MAX_FILES:
                files.append(included)
            continue
        sources.read_terms.append(read_term)
        sources.goals.append(_create_source_goal(goal, read_term))


def _create_source_goal(goal: Term, read_term: ReadTerm) -> SourceTerm:
    parent = wrap_term(goal)

    def place_of(part: Term, position: int = 0) -> Place:
        # The wrapping term is not in the source: its place is that of the goal.
        return read_term.place_of(goal) if part is parent else read_term.place_of(part, position)

    return SourceTerm(None, parent, 1, place_of, read_term.place)


def _add_file(sources: ParsedSources, program: Iterable[Union[ReadTerm, SyntaxFault]]) -> None:
    for read_term in program:
        if isinstance(read_term, SyntaxFault):
            continue
        parser = EventFileParser()
        parser.parse_read_term(read_term)
        sources.read_terms.append(read_term)
        for definition in [*parser.rules, *parser.nested_rules]:
            sources.rules.append(SourceRule(definition, read_term.place_of))
        for entry in parser.entries:
            if entry.kind is EntryKind.CLAUSE:
                sources.clauses.append(source_clause_of(entry.term, read_term.place_of, read_term.place))
            elif entry.kind is EntryKind.DIRECTIVE:
                sources.goals.append(_create_source_goal(entry.term, read_term))


def source_clause_of(term: Any, place_of: PlaceLookup, place: Optional[Place]) -> SourceTerm:
    """Return the parts of a clause.

    A grammar rule gets the body ``true``, because its goals are known after its translation only.
    """
    if term.__class__ is tuple and term[0] is NECK:
        return SourceTerm(deref(term[1]), term, 2, place_of, place)
    if term.__class__ is tuple and term[0] is _GRAMMAR:
        key = functor_of(term[1])
        if key is not None:
            # The translation of a grammar rule adds two arguments, for the list and its rest.
            head: Tuple[Any, ...] = (functor(key.name, key.arity + 2), *[Var() for _ in range(key.arity + 2)])
            return SourceTerm(head, wrap_term(TRUE), 1, place_of, place)
    return SourceTerm(term, wrap_term(TRUE), 1, place_of, place)


def create_clause(head: Term, body: Term, place: Optional[Place]) -> SourceTerm:
    """Return a clause with the place of its start; the places of its subterms are unknown."""
    return SourceTerm(head, (NECK, head, body), 2, constant_place_lookup(place), place)


def constant_place_lookup(place: Optional[Place]) -> PlaceLookup:
    """Return a function that returns the same place for all parts."""
    if place is None:
        return no_place

    def place_of(part: Term, position: int = 0) -> Optional[Place]:
        return place

    return place_of


MEMORIZE = frozenset((functor("memorize", 5), functor("memorize", 6), functor("memorize_diactive", 5)))
SUBSCRIBE = functor("subscribe", 5)


class EventConsumer(NamedTuple):
    """Memory or subscription.

    Attributes:
        term: the goal: ``memorize(Pattern, Conditions, Template, Id, Size)`` or
            ``subscribe(Pattern, Conditions, Template, Topic, Id)``.
        prefix: beginning of warnings about it, which names it if its place is unknown; otherwise empty.
        place_of: returns the places of its parts.
    """

    term: CompoundTerm
    prefix: str
    place_of: PlaceLookup

    @property
    def pattern(self) -> Term:
        """The events that it consumes."""
        pattern: Term = self.event.term
        return pattern

    @property
    def event(self) -> Subterm:
        """The event pattern and its position; for ``P with S`` the event is P, inside that term."""
        consumed = deref(self.term[1])
        event = subscription_event(consumed) if self.term[0] is SUBSCRIBE else consumed
        return Subterm(event, self.term if event is consumed else _as_compound(consumed), 1, self.place_of)

    @property
    def template(self) -> Term:
        """The template of its records or outputs, as written."""
        return deref(self.term[3])

    @property
    def stores_whole_event(self) -> bool:
        """True if the template is a free variable such as ``_``: then the event itself is stored or sent."""
        return is_event_variable(self.pattern, deref(self.term[2]), self.template)

    @property
    def output_term(self) -> Term:
        """The term that is stored or sent: the template, or the event itself."""
        return self.pattern if self.stores_whole_event else self.template


class StateDeclaration(NamedTuple):
    """Declared state, with a function for the places of its parts and a prefix for warnings without a place."""

    form: StateForm
    place_of: PlaceLookup
    prefix: str


class RecordedTopic(NamedTuple):
    """Topic of a bag.

    Attributes:
        topic: its name.
        type: its message type.
        period: mean time between two of its messages in seconds, if they are spread over the whole bag; None for
            less than two.
    """

    topic: str
    type: str
    period: Optional[float] = None


class ProgramModel:
    """Loaded program with its files.

    Args:
        knowledge: the memories, subscriptions and states.
        definitions: the known message types.
        topics: contents of ``pub_sub.xml``.
        directly_subscribed: topics that node retalis subscribes to itself.
        folder: the folder of the program, or its only event file; None if only the loaded program is checked.
        has_observer: whether there is an observer of all events.
        recorded_topics: topics of bags that the program is to run with.
        find_refusal: returns the reason why goals may not call a service, or "".
    """

    def __init__(
        self,
        rules: RuleBase,
        knowledge: KnowledgeBase,
        definitions: Definitions,
        topics: Topics,
        directly_subscribed: Tuple[TopicType, ...] = (),
        folder: Optional[Path] = None,
        has_observer: bool = False,
        recorded_topics: Tuple[RecordedTopic, ...] = (),
        find_refusal: Callable[[str], str] = lambda name: "",
    ):
        self.rule_base = rules
        self.logic: PrologSystem = rules.logic
        self._types_by_event_name = {
            topics.event_name_of(topic): type_name
            for topic, type_name in topics.subscribed
            if topics.event_name_of(topic)
        }
        self.definitions = definitions
        self.topics = topics
        self.directly_subscribed = directly_subscribed
        self.folder = folder
        self.has_observer = has_observer
        self.recorded_topics = recorded_topics
        self.awaited_constants: Dict[str, Place] = {}
        self.find_refusal = find_refusal
        files = ParsedSources([], [], [], [], set())
        if folder is not None:
            message_types = self.logic.operators.message_types
            # Constants of unknown types that were accepted when the program was loaded are accepted again.
            with nullcontext({}) if message_types is None else message_types.awaiting() as places:
                files = parse_sources_again(self.logic, folder, rules.files.loaded)
            self.awaited_constants.update(places)
        self.read_terms: List[ReadTerm] = files.read_terms
        self.names: Dict[Var, str] = {
            var: name for read in files.read_terms for name, var in read.names.items()
        }
        self.goals: List[SourceTerm] = files.goals
        self.rules = [*files.rules, *_rules_from_elsewhere(rules, files.paths)]
        self.clauses = [*files.clauses, *_clauses_from_elsewhere(self.logic, files.paths)]
        self.declarations = rules.declared_events.current_declarations()
        self.memories: List[EventConsumer] = []
        self.subscriptions: List[EventConsumer] = []
        self.states: List[StateDeclaration] = []
        self._collect_consumers(knowledge)
        self._collect_states(knowledge)
        self._definitions_by_type: Dict[str, Optional[Definition]] = {}
        self._analyses: Dict[Callable[[ProgramModel], Any], Any] = {}

    def names_in(self, rule: SourceRule) -> Mapping[Var, str]:
        """Return the names of the variables of a rule, and of the program."""
        # Not a merged dictionary: a program has as many names as its rules together.
        return ChainMap(dict(rule.definition.names), self.names)

    def brief(self, term: Term, names: Optional[Mapping[Var, str]] = None) -> str:
        """Return the text of a term for reports, with the names of its variables; by default those of the program."""
        known_names = self.names if names is None else names
        # Only the names that occur: the text would otherwise take as long as the program has variables.
        return self.logic.brief(
            term, {var: known_names[var] for var in variables(term) if var in known_names}
        )

    def derive(self, analyse: Callable[["ProgramModel"], Analysis]) -> Analysis:
        """Return the result of an analysis of this program, which several checks share; it runs once."""
        if analyse not in self._analyses:
            self._analyses[analyse] = analyse(self)
        analysis: Analysis = self._analyses[analyse]
        return analysis

    def definition(self, type_name: Optional[str]) -> Optional[Definition]:
        """Return the definition of a message type, or None if it is unknown."""
        if type_name is None:
            return None
        if type_name not in self._definitions_by_type:
            try:
                # Unknown types are stored as None, so that their files are searched once.
                self._definitions_by_type[type_name] = self.definitions.find(type_name)
            except MessageError:
                self._definitions_by_type[type_name] = None
        return self._definitions_by_type[type_name]

    def event_name_of(self, topic: str) -> str:
        """Return the event name of a topic if it differs from that of its type, else ""."""
        return self.topics.event_name_of(topic)

    def type_of(self, name: str) -> Optional[str]:
        """Return the message type of the events with a name, or None."""
        return type_name(name) or self._types_by_event_name.get(name)

    def message_of(self, term: Any) -> Optional[Definition]:
        """Return the definition of the message type of a term.

        It is None if the term is no message or has another number of slots.
        """
        definition = self.definition(self.type_of(term[0].name)) if term.__class__ is tuple else None
        return definition if definition is not None and len(definition.fields) == len(term) - 1 else None

    def patterns(self) -> Iterator[Tuple[Subterm, str]]:
        """Yield the awaited events, each with a prefix for warnings without a place."""
        for rule in self.rules:
            term = rule.definition.term
            rule_subterms = list(
                subterms(_wrap_rule(rule), 1, rule.place_of)
                if rule.definition.head is None or term.__class__ is not tuple
                else subterms(term, 2, rule.place_of)
            )
            for node in walk(rule.definition.pattern, negated=True):
                if isinstance(node, EventPattern):
                    yield _locate(rule_subterms, deref(node.term), rule.place_of), ""
        for consumer in (*self.memories, *self.subscriptions):
            yield consumer.event, consumer.prefix
        for form, place_of, prefix in self.states:
            for part in map(deref, _as_compound(form.term)[2:4]):
                parent = _as_compound(part)
                yield Subterm(deref(parent[1]), parent, 1, place_of), prefix

    def calls(self) -> Iterator[Subterm]:
        """Yield the calls in goals of files, bodies of clauses, and goals of rules."""
        calls_with_places = [
            (source_term.parent, source_term.position, source_term.place_of)
            for source_term in (*self.goals, *self.clauses)
        ]
        for rule in self.rules:
            for part in walk(rule.definition.pattern, negated=True):
                if not isinstance(part, EventPattern):
                    calls_with_places += [(wrap_term(goal), 1, rule.place_of) for goal in own_terms(part)]
        for parent, position, place_of in calls_with_places:
            for call in calls(parent, position):
                yield Subterm(call.term, call.parent, call.position, place_of)

    def all_subterms(self) -> Iterator[Subterm]:
        """Yield all subterms of goals, clauses and rules."""
        for source_term in (*self.goals, *self.clauses):
            yield from subterms(source_term.parent, source_term.position, source_term.place_of)
        for rule in self.rules:
            yield from subterms(_wrap_rule(rule), 1, rule.place_of)

    def _collect_consumers(self, knowledge: KnowledgeBase) -> None:
        """Collect memories and subscriptions, from the files and from the loaded program."""
        keys_in_files: Set[Tuple[str, Any]] = set()
        for subterm in self.all_subterms():
            term = subterm.term
            if term.__class__ is not tuple or (term[0] not in MEMORIZE and term[0] is not SUBSCRIBE):
                continue
            if subterm.key is SUBSCRIBE:
                self.subscriptions.append(EventConsumer(term, "", subterm.place_of))
                keys_in_files.add((self.topic_of(term[4]), term_key(deref(term[5]))))
            else:
                self.memories.append(EventConsumer(term, "", subterm.place_of))
                keys_in_files.add(("", term_key(deref(term[4]))))
        for instance in knowledge.memories:
            # Memories of the files were collected with places already; the others were created at run time.
            if ("", term_key(instance.id)) not in keys_in_files:
                prefix = f"memory {self.logic.brief(instance.id)}: "
                self.memories.append(
                    EventConsumer(_as_compound(instance.definition), prefix, constant_place_lookup(None))
                )
        for (topic, _), subscription in knowledge.subscriptions.items():
            if (topic, term_key(subscription.id)) not in keys_in_files:
                prefix = f"a subscription of topic {topic}: "
                self.subscriptions.append(
                    EventConsumer(_as_compound(subscription.definition), prefix, constant_place_lookup(None))
                )

    def _collect_states(self, knowledge: KnowledgeBase) -> None:
        """Collect declared states, from the files and from the loaded program."""
        keys_in_files = set()
        for subterm in self.all_subterms():
            if declares_state(subterm.term):
                try:
                    form = parse_state_declaration(subterm.term)
                except UsageError:
                    # Reported when it was declared.
                    continue
                self.states.append(StateDeclaration(form, subterm.place_of, ""))
                keys_in_files.add(form.key)
        for state in knowledge.states:
            if state.form.key not in keys_in_files:
                self.states.append(
                    StateDeclaration(state.form, constant_place_lookup(None), f"{state.name}: ")
                )

    def topic_of(self, term: Term) -> str:
        """Return the topic of a subscription, which need not be an atom, as text."""
        topic: Any = deref(term)
        return str(topic.name) if hasattr(topic, "name") else self.logic.show(topic, quoted=False)


def _as_compound(term: Any) -> CompoundTerm:
    """Return a term unchanged; its type is known here and not to mypy."""
    compound: CompoundTerm = term
    return compound


def _wrap_rule(rule: SourceRule) -> CompoundTerm:
    return wrap_term(rule.definition.term)


def _locate(rule_subterms: List[Subterm], term: Term, place_of: PlaceLookup) -> Subterm:
    """Return a term of a rule with its place; for copies in repetitions, the place of the rule."""
    occurrences_of_term = [subterm for subterm in rule_subterms if subterm.term is term]
    # The same atom may also occur in an earlier goal: the event is the one that is an operand of an operator.
    operands = [
        subterm
        for subterm in occurrences_of_term
        if subterm is rule_subterms[0] or subterm.parent[0] in OPERATOR_NAMES
    ]
    candidates = operands or occurrences_of_term
    return candidates[0] if candidates else Subterm(term, wrap_term(term), 1, place_of)


def _rules_from_elsewhere(rules: RuleBase, parsed_paths: Set[str]) -> List[SourceRule]:
    """Return the rules that are not in a parsed file."""
    return [
        SourceRule(rule.definition, constant_place_lookup(rule.place))
        for rule in rules.rules
        if rule.place is None or rule.place.source not in parsed_paths
    ]


def _clauses_from_elsewhere(logic: PrologSystem, parsed_paths: Set[str]) -> List[SourceTerm]:
    """Return the clauses that are not in a parsed file."""
    clauses = []
    for predicate in list(logic.database.predicates.values()):
        # Predicates of libraries are not part of the program.
        if predicate.kind == "user" and not predicate.is_library_predicate:
            for clause in predicate.active_clauses():
                if clause.place is None or clause.place.source not in parsed_paths:
                    clauses.append(create_clause(clause.head, clause.body, clause.place))
    return clauses


def is_variable(term: Term) -> bool:
    """Return whether a term is a variable."""
    return deref(term).__class__ is Var
