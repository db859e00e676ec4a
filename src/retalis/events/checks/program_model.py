"""What was probably meant by a name that nobody knows.

A program's files read once more for the places of what stands in them: what was loaded does not keep those.

All that is known of a program when it has been loaded, for the checks.
"""

import os
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Optional, Set, Tuple, Union

from ...foundation.errors import MessageError, Place, SyntaxFault, UsageError
from ...messages.type_definition import Definition, type_name
from ...messages.type_registry import Definitions
from ...prolog.syntax.term_reader import OF_FILES, ReadTerm, read_program
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import TRUE, Atom, CompoundTerm, Functor, String, Term, Var, deref, functor
from ..knowledge.knowledge_base import KnowledgeBase
from ..knowledge.memory import is_whole
from ..language.goal_analysis import calls
from ..language.pattern_operators import SPELLINGS
from ..language.pattern_parser import Spot
from ..language.pattern_tree import Occurs, RuleDefinition, own_terms, walk
from ..language.state_parser import StateForm, declares_state, state_form
from ..language.window_parser import subscribed_event
from ..program.event_file_checker import FileChecker, nowhere
from ..program.goal_file import goal_of, read_goals
from ..program.program_folder import GOALS, Topics, TopicType, read_text
from ..rules.rule_base import RuleBase

_MAX_CANDIDATES = 2000
"""Names among which one is looked for."""

COMPARISONS = 40_000
"""Names that a check compares; about a second."""


def near(name: str, names: Iterable[str], alike: float = 0.66) -> str:
    """Return the name that is most like another, or ""."""
    found = get_close_matches(name, list(dict.fromkeys(names))[:_MAX_CANDIDATES], 1, alike)
    return found[0] if found else ""


def meant(name: str, names: Iterable[str], alike: float = 0.66) -> str:
    """Return the question whether another name was meant, behind a semicolon; "" where none is like it."""
    found = near(name, names, alike)
    return f"; did you mean {found}?" if found else ""


class NearFunctors:
    """Finds the functors that were probably meant by others, until that has taken its time."""

    def __init__(self) -> None:
        self._left = COMPARISONS

    def of(self, key: Functor, keys: Iterable[Functor]) -> str:
        """Return the functor that was probably meant: of the same name, or of one that is like it; or ""."""
        known = list(keys)
        same = [one for one in known if one.name == key.name and one is not key]
        if not same:
            names = list(dict.fromkeys(one.name for one in known))[:_MAX_CANDIDATES]
            self._left -= len(names)
            name = near(key.name, names) if self._left >= 0 else ""
            same = [one for one in known if one.name == name]
        return str(min(same, key=lambda one: abs(one.arity - key.arity))) if same else ""


MAX_SOURCE_CHARACTERS = 1 << 20
"""Characters of a file that is read once more; of what stands in a longer one only the rules' places are known."""

_MAX_FILES = 100

NECK = functor(":-", 2)
_GRAMMAR = functor("-->", 2)
_HOLDER = functor("$goal", 1)
_INCLUDE = functor("include", 1)
_LOADS = frozenset(
    functor(name, 1)
    for name in ("compile_event_file", "compile_events", "consult", "ensure_loaded", "use_module")
)


class WrittenRule(NamedTuple):
    """A rule and what gives the places of its parts."""

    definition: RuleDefinition
    spot: Spot


class WrittenTerm(NamedTuple):
    """A clause, or a goal of a goal file or directive, whose head is None.

    Attributes:
        head: of the clause.
        parent: the term of which the body is an argument, the ``number``-th.
        spot: gives the places of its parts.
        place: where it begins.
    """

    head: Optional[Term]
    parent: CompoundTerm
    number: int
    spot: Spot
    place: Optional[Place]


class Inner(NamedTuple):
    """A term inside another, as the ``number``-th argument of ``parent``."""

    term: Any
    parent: CompoundTerm
    number: int
    spot: Spot

    @property
    def place(self) -> Optional[Place]:
        """Where it begins; of an operator, where that stands."""
        if self.term.__class__ is tuple:
            return self.spot(self.term)
        return self.spot(self.parent, self.number)

    @property
    def key(self) -> Optional[Functor]:
        """The functor of an atom or a compound term."""
        return key_of(self.term)


def key_of(term: Any) -> Optional[Functor]:
    """Return the functor of an atom or a compound term, None for another term."""
    term = deref(term)
    return term[0] if term.__class__ is tuple else term.functor if term.__class__ is Atom else None


def inners(parent: CompoundTerm, number: int, spot: Spot) -> Iterator[Inner]:
    """Yield an argument of a term and all terms in it, from left to right."""
    stack = [Inner(deref(parent[number]), parent, number, spot)]
    while stack:
        inner = stack.pop()
        yield inner
        term = inner.term
        if term.__class__ is tuple:
            stack += [Inner(deref(term[at]), term, at, spot) for at in range(len(term) - 1, 0, -1)]


def held(term: Term) -> CompoundTerm:
    """Return a term that has another as its only argument."""
    return (_HOLDER, term)


class SourcePositions(NamedTuple):
    """What stands in a program's files."""

    rules: List[WrittenRule]
    clauses: List[WrittenTerm]
    goals: List[WrittenTerm]
    reads: List[ReadTerm]
    sources: Set[str]


def read_again(logic: PrologSystem, folder: Path, loaded: Iterable[Path]) -> SourcePositions:
    """Read the files of a program once more.

    Args:
        logic: by whose operators they are read.
        folder: the program's.
        loaded: the real paths of its files; one that a goal names and that was not loaded is read, too.
    """
    found = SourcePositions([], [], [], [], set())
    real = Path(os.path.realpath(folder))
    goal_files = [folder / GOALS]
    for path in goal_files:
        _add_goals(found, goal_files, path, logic)
    seen = {os.path.realpath(path) for path in goal_files}
    named = [*_named(found.goals, folder), *sorted(_shown(path, real, folder) for path in loaded)]
    for path in named:
        if os.path.realpath(path) not in seen:
            seen.add(os.path.realpath(path))
            text = _text(path)
            if text:
                found.sources.add(str(path))
                _add_file(found, read_program(text, logic.operators.copy(), str(path), OF_FILES))
    return found


def _shown(path: Path, real: Path, folder: Path) -> Path:
    """Return a path as the program's own goals name it."""
    try:
        return folder / path.relative_to(real)
    except ValueError:
        return path


def _named(goals: Iterable[WrittenTerm], folder: Path) -> Iterator[Path]:
    """Yield the files that goals load, in their order."""
    for goal in goals:
        for inner in inners(goal.parent, goal.number, goal.spot):
            if inner.term.__class__ is tuple and inner.key in _LOADS:
                name = _plain(deref(inner.term[1]))
                if name and os.path.isfile(folder / name):
                    yield folder / name


def _plain(name: Any) -> str:
    """Return the text of an atom or string that a file may be called."""
    text = name.name if name.__class__ is Atom else name.text if name.__class__ is String else ""
    return "" if "\0" in text else text


def _text(path: Path) -> str:
    try:
        text = read_text(path)
    except UsageError:  # said when it was loaded
        return ""
    return text if len(text) <= MAX_SOURCE_CHARACTERS else ""


def _add_goals(found: SourcePositions, files: List[Path], path: Path, logic: PrologSystem) -> None:
    for read in read_goals(_text(path), logic.operators, str(path)):
        if not isinstance(read, ReadTerm):
            continue
        goal: Any = goal_of(read.term)
        if goal.__class__ is tuple and goal[0] is _INCLUDE:
            included = path.parent / (_plain(deref(goal[1])) or path.name)
            if included not in files and len(files) < _MAX_FILES:
                files.append(included)
            continue
        found.reads.append(read)
        found.goals.append(_goal(goal, read))


def _goal(goal: Term, read: ReadTerm) -> WrittenTerm:
    parent = held(goal)

    def spot(part: Term, number: int = 0) -> Place:
        return read.place_of(goal) if part is parent else read.place_of(part, number)

    return WrittenTerm(None, parent, 1, spot, read.place)


def _add_file(found: SourcePositions, program: Iterable[Union[ReadTerm, SyntaxFault]]) -> None:
    for read in program:
        if isinstance(read, SyntaxFault):
            continue
        checker = FileChecker()
        checker.read(read)
        found.reads.append(read)
        for definition in [*checker.rules, *checker.inner]:
            found.rules.append(WrittenRule(definition, read.place_of))
        for step in checker.steps:
            if step.kind == "clause":
                found.clauses.append(clause_of(step.term, read.place_of, read.place))
            elif step.kind == "directive":
                found.goals.append(_goal(step.term, read))


def clause_of(term: Any, spot: Spot, place: Optional[Place]) -> WrittenTerm:
    """Return a clause, taken apart; of a grammar rule only which predicate it is."""
    if term.__class__ is tuple and term[0] is NECK:
        return WrittenTerm(deref(term[1]), term, 2, spot, place)
    if term.__class__ is tuple and term[0] is _GRAMMAR:
        key = key_of(term[1])
        if key is not None:
            head: Tuple[Any, ...] = (functor(key.name, key.arity + 2), *[Var() for _ in range(key.arity + 2)])
            return WrittenTerm(head, held(TRUE), 1, spot, place)
    return WrittenTerm(term, held(TRUE), 1, spot, place)


def clause_at(head: Term, body: Term, place: Optional[Place]) -> WrittenTerm:
    """Return a clause of which only the place is known where it begins."""
    return WrittenTerm(head, (NECK, head, body), 2, everywhere(place), place)


def everywhere(place: Optional[Place]) -> Spot:
    """Return what gives one place for all parts."""
    if place is None:
        return nowhere

    def spot(part: Term, number: int = 0) -> Optional[Place]:
        return place

    return spot


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


class ProgramModel:
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
        rules: RuleBase,
        knowledge: KnowledgeBase,
        definitions: Definitions,
        topics: Topics,
        direct: Tuple[TopicType, ...] = (),
        folder: Optional[Path] = None,
        observed: bool = False,
    ):
        self.loaded = rules
        self.logic: PrologSystem = rules.logic
        self._renamed = {
            topics.event_of(topic): kind for topic, kind in topics.subscribed if topics.event_of(topic)
        }
        self.definitions = definitions
        self.topics = topics
        self.direct = direct
        self.folder = folder
        self.observed = observed
        files = SourcePositions([], [], [], [], set())
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

    def _keep(self, knowledge: KnowledgeBase) -> None:
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

    def _note_states(self, knowledge: KnowledgeBase) -> None:
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


def _other_rules(rules: RuleBase, sources: Set[str]) -> List[WrittenRule]:
    """Return the rules that stand in no file that was read."""
    return [
        WrittenRule(rule.definition, everywhere(rule.place))
        for rule in rules.rules
        if rule.place is None or rule.place.source not in sources
    ]


def _other_clauses(logic: PrologSystem, sources: Set[str]) -> List[WrittenTerm]:
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
