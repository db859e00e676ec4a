"""The parts of two versions of a program whose outputs can differ.

`find_difference` compares two loaded versions term by term, so that comments, layout and names of variables make no
difference. Rules, predicates, subscriptions and topics that only one version has are *different*. The difference
reaches every rule and subscription that awaits an event of what it has reached. These are run, and the rules that
raise the events that they await (a program slice). All other rules have equal inputs and equal definitions in both
versions, so their outputs are equal.

This holds if rules affect each other by events only. `ProgramVersion.is_followed` is therefore true only for programs
that have neither memories, states, timers, alarms, dynamic predicates, transforms nor synchronized queries, and whose
goals raise events, or call predicates of the program or built-in ones without effects. All others are run whole. Two
versions with equal files need no such condition, unless they read further files.

A bag limits the difference: a rule cannot match if an event that it needs comes from a topic that the bag does not
have.
"""

from bisect import bisect_left
from enum import Enum
from itertools import starmap
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ..engine.engine import Engine
from ..engine.loaded_items import clause_key
from ..events.checks.abstract_store import raised_event
from ..events.checks.event_flow_checks import SUBSCRIBE_TO
from ..events.checks.program_model import MAX_SOURCE_CHARACTERS, SUBSCRIBE, ProgramModel, subterms, wrap_term
from ..events.knowledge.knowledge_base import OWN_EVENTS
from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.language.called_predicates import calls
from ..events.language.pattern_parser import no_place
from ..events.language.pattern_tree import (
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    OrPattern,
    PairPattern,
    Pattern,
    WindowPattern,
    children,
    walk,
)
from ..events.language.rule_heads import ALARMS, NEW_EVENT, SYNCHRONIZED, event_raised_by
from ..events.language.stream_parser import subscription_event
from ..events.network.event_rule import EventRule
from ..events.program.topic_configuration import AUTO, TOPICS, Topics, direct_topics, read_topics
from ..events.provenance.explanation_terms import label_of
from ..foundation.ros_name_checks import strip_slashes
from ..messages.action_events import find_action_event
from ..messages.type_registry import Definitions
from ..playback.bag_locations import Bag
from ..playback.bag_transport import list_topic_names
from ..prolog.builtins.builtin_registry import ENTRIES
from ..prolog.terms.list_terms import list_items
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.types import Atom, CompoundTerm, Functor, String, Term, deref, functor, functor_of

_FOLLOWED_MODULES = frozenset(
    f"retalis.prolog.builtins.{name}"
    for name in ("array_predicates", "association_lists", "atoms_and_strings", "list_predicates")
    + ("term_tests_and_arithmetic",)
)
"""Modules of built-in predicates whose result depends on their arguments alone, and that have no effects."""

_UNFOLLOWED_BUILTINS = frozenset(
    ("dif", "freeze", "when", "random", "random_between", "random_member", "random_permutation", "set_random")
)
"""Predicates of these modules that are exceptions."""

_FOLLOWED_NAMES = frozenset(
    name
    for names in (
        "! true fail false otherwise t1 t2",
        "functor arg =.. copy_term",
        "member append select selectchk delete permutation flatten nextto",
        "pairs_keys pairs_values pairs_keys_values list_to_assoc empty_assoc",
        "== \\== @< @> @=< @>= =:= =\\= < > =< >=",
    )
    for name in names.split()
)
"""Names of further predicates, control constructs included, for which the same holds."""

_CHANGING_FUNCTIONS = frozenset(
    functor(name, arity)
    for name, arity in (("random", 0), ("random", 1), ("random_float", 0), ("cputime", 0), ("realtime", 0))
)
"""Arithmetic functions whose value changes."""

_LOADING_GOALS = frozenset(
    functor(name, 1) for name in ("compile_event_file", "compile_events", "consult", "ensure_loaded")
)
"""Goals of files whose effects are compared: rules, clauses and topics."""

_SETTING_GOALS = frozenset((functor("set_etalis_flag", 2), functor("op", 3)))
"""Goals of files that are compared themselves."""

_FOLLOWED_FLAGS = frozenset(
    ("event_consumption_policy", "out_of_order", "watermark_delay", "max_watermark_delay")
)
"""Flags that affect each rule by itself; others must have their default."""

_EVENT_FACTS = frozenset(
    ("external_trigger", "print_trigger", "spy_event", "persistent_event", "persistent_rule")
)
"""Facts that have an effect on all events of a name."""

_FILE_PREDICATES = frozenset(
    name
    for names in (
        "open see load_files use_module execute_event_stream_file",
        "read_file_to_terms read_file_to_string read_file_to_codes phrase_from_file",
        "exists_file exists_directory absolute_file_name getenv",
    )
    for name in names.split()
)
"""Names of predicates that read files or the environment, which may differ although the program is equal."""

_FORMAT = functor("format", 3)
_TEXT_SINKS = frozenset(functor(name, 1) for name in ("atom", "string", "codes", "chars"))
_EVENT_AT_PRESENT = functor("event", 1)
_REV = "rev"


class Extent(Enum):
    """The extent to which two versions have to be run."""

    EQUAL = "equal"
    """Not at all: the versions are equal."""
    UNREACHED = "unreached"
    """Not at all: the bag has no event that the differing parts need."""
    PART = "part"
    """The rules that the difference reaches, and those that these need."""
    WHOLE = "whole"
    """The whole programs."""


class VersionPart(NamedTuple):
    """Part of a version.

    Attributes:
        subscriptions: topics and ids of its subscriptions.
    """

    rules: FrozenSet[EventRule]
    subscriptions: FrozenSet[SubscriptionKey]


class VersionDifference(NamedTuple):
    """Difference between two versions for a bag.

    Attributes:
        extent: what has to be run.
        parts: for `Extent.PART`, the parts of both versions.
        event_names: names of the events that these await.
    """

    extent: Extent
    parts: Tuple[VersionPart, ...] = ()
    event_names: FrozenSet[str] = frozenset()


class _Unfollowed(Exception):
    """The program has a part whose effects are not followed."""


class _SliceItem:
    """Rule or subscription.

    Args:
        item: the rule, or topic and id of the subscription.
        key: key that is equal for equal consumers.
        pattern: the pattern; an event for a subscription.
        raised: names of the events that it raises.
        predicates: the predicates of the program that it calls, directly or not.

    Attributes:
        awaited: names of the events in the pattern.
        output_topic: full name of the topic of a subscription; "" for a rule.
    """

    def __init__(
        self,
        item: Union[EventRule, SubscriptionKey],
        key: Hashable,
        pattern: Pattern,
        raised: FrozenSet[str],
        predicates: FrozenSet[Functor],
    ):
        self.item = item
        self.key = key
        self.pattern = pattern
        self.awaited = _awaited_names(pattern)
        self.raised = raised
        self.predicates = predicates
        self.output_topic = "" if isinstance(item, EventRule) else strip_slashes(item[0])


class ProgramVersion:
    """A loaded version of a program, as far as its comparison needs it.

    Args:
        engine: its engine, before the first event; it has loaded this folder only.
        definitions: the known message types.

    Attributes:
        topics: contents of its ``pub_sub.xml``, with the topics that goals and nodes subscribe to.
        is_followed: whether its rules affect each other by events only.
        consumers: its rules in order, and its subscriptions; incomplete if the version is not followed.
        clauses: keys of the clauses of its predicates.
        settings: keys of goals that are compared as they are.
    """

    def __init__(self, folder: Path, engine: Engine, definitions: Definitions):
        self._program = program = engine.program
        (self._items,) = engine.loaded_deployments().values()
        topics = engine.with_requested_topics(read_topics(folder / TOPICS))
        self.topics = topics._replace(
            subscribed=(*topics.subscribed, *direct_topics(AUTO, topics, strip_slashes))
        )
        self._model = ProgramModel(
            program.rules, program.knowledge, definitions.with_strings(engine.strings), topics, (), folder
        )
        self.clauses: Dict[Functor, List[Hashable]] = {}
        self._bodies: Dict[Functor, List[Term]] = {}
        for predicate, clauses in self._items.clauses.items():
            if clauses:
                self.clauses[predicate.functor] = list(map(clause_key, clauses))
                self._bodies[predicate.functor] = [clause.body for clause in clauses]
        self.consumers: List[_SliceItem] = []
        self.settings: List[Hashable] = []
        try:
            self._check_items()
            self._read_goals()
            self.consumers += map(self._read_rule, self._items.rules)
            self.consumers += starmap(self._read_subscription, self._items.subscriptions.items())
            self.is_followed = True
        except _Unfollowed:
            self.is_followed = False

    def source_key(self) -> Optional[Hashable]:
        """Return a key that is equal for versions with equal files; None if results depend on further files."""
        # Longer files are not parsed again.
        if not all(map(_is_short, self._items.files)):
            return None
        if any(
            getattr(subterm.key, "name", "") in _FILE_PREDICATES for subterm in self._model.all_subterms()
        ):
            return None
        # Files that rules load are not known yet.
        if any(_mentions(term, _LOADING_GOALS) for term in self._program.rules.terms()):
            return None
        return (
            tuple(term_key(read_term.term) for read_term in self._model.read_terms),
            tuple(map(self._make_rule_key, self._items.rules)),
            tuple((key, tuple(clauses)) for key, clauses in self.clauses.items()),
            self.topics,
        )

    def _make_rule_key(self, rule: EventRule) -> Hashable:
        # Rules without a label may have properties, too.
        label = label_of(rule)
        properties = self._program.rules.properties(label)
        return (
            rule.definition.key,
            term_key(label),
            tuple((prop.name, term_key(prop.value)) for prop in properties),
        )

    def _check_items(self) -> None:
        """Raise an error if the program has items by which rules affect each other."""
        items, flags = self._items, self._program.rules.flags
        if (
            items.memories
            or items.states
            or items.timers
            or items.dynamic
            or items.replaced
            or self._program.knowledge.transforms.is_required
            or not flags.changed_flags().keys() <= _FOLLOWED_FLAGS
            or any(key.name in _EVENT_FACTS for key in self.clauses)
            # The goals of longer files are not known.
            or not all(map(_is_short, items.files))
            or any(_mentions(term, _CHANGING_FUNCTIONS) for term in self._program.rules.terms())
        ):
            raise _Unfollowed

    def _read_goals(self) -> None:
        """Check the goals of the files, and list those that are compared as they are."""
        for goal in self._model.goals:
            for call in calls(goal.parent, goal.position):
                key = functor_of(call.term)
                if key in _SETTING_GOALS:
                    self.settings.append(term_key(call.term))
                elif key not in _LOADING_GOALS and key is not SUBSCRIBE and key not in SUBSCRIBE_TO:
                    raise _Unfollowed

    def _read_rule(self, rule: EventRule) -> _SliceItem:
        """Return what a rule awaits, raises and calls."""
        definition = rule.definition
        head: Any = definition.head
        if head.__class__ is tuple and (head[0] in ALARMS or head[0] in SYNCHRONIZED):
            raise _Unfollowed
        goals = []
        for node in walk(definition.pattern, negated=True):
            if isinstance(node, (ConditionPattern, ActionPattern)):
                goals.append(node.goal)
            elif isinstance(node, WindowPattern):
                # Aggregates may call predicates by their names.
                if any(
                    not isinstance(setting, (int, float)) for setting in node.settings if setting is not None
                ):
                    raise _Unfollowed
                goals += node.window.goals
            elif isinstance(node, AggregatePattern) and not isinstance(
                node.setting, (int, float, type(None))
            ):
                raise _Unfollowed
        predicates, raised = self._follow(goals)
        raised_by_head = event_raised_by(head)
        if raised_by_head is not None:
            raised |= {_name_of(raised_by_head)}
        return _SliceItem(rule, self._make_rule_key(rule), definition.pattern, raised, predicates)

    def _read_subscription(self, key: SubscriptionKey, subscription: Subscription) -> _SliceItem:
        """Return what a subscription awaits and calls."""
        definition: Any = subscription.definition
        pattern = EventPattern(subscription_event(definition[1]))
        conditions = list_items(definition[2])
        if conditions is None:
            raise _Unfollowed
        predicates, raised = self._follow(conditions)
        return _SliceItem(key, (key, subscription.key), pattern, raised, predicates)

    def _follow(self, goals: Sequence[Term]) -> Tuple[FrozenSet[Functor], FrozenSet[str]]:
        """Return the predicates of the program that goals call, directly or not, and names of events that they raise.

        Raises:
            _Unfollowed: if a goal may have another effect, or its result may depend on something else.
        """
        predicates: Set[Functor] = set()
        raised: Set[str] = set()
        stack = list(goals)
        while stack:
            goal = stack.pop()
            for call in calls(wrap_term(goal), 1):
                key = functor_of(call.term)
                if key in self._bodies:
                    if key not in predicates:
                        predicates.add(key)
                        stack += self._bodies[key]
                elif key in NEW_EVENT and key is not _EVENT_AT_PRESENT:
                    raised.add(_name_of(raised_event(_as_compound(call.term))))
                elif not (_is_followed(key) or _formats_text(call.term)):
                    raise _Unfollowed
        return frozenset(predicates), frozenset(raised)


def _is_short(path: Path) -> bool:
    try:
        return path.stat().st_size <= MAX_SOURCE_CHARACTERS
    except OSError:
        return False


def _as_compound(term: Any) -> CompoundTerm:
    """Return a term unchanged; its type is known here and not to mypy."""
    compound: CompoundTerm = term
    return compound


def _is_followed(key: Optional[Functor]) -> bool:
    """Return whether a predicate of the system has no effects, and depends on its arguments alone."""
    if key is None:
        return False
    entry = ENTRIES.get((key.name, key.arity))
    is_in_module = entry is not None and entry.function.__module__ in _FOLLOWED_MODULES
    return key.name in _FOLLOWED_NAMES or (is_in_module and key.name not in _UNFOLLOWED_BUILTINS)


def _formats_text(goal: Any) -> bool:
    """Return whether a goal is ``format/3`` that creates a text, without directives that call goals."""
    if goal.__class__ is not tuple or goal[0] is not _FORMAT:
        return False
    sink, text = functor_of(goal[1]), deref(goal[2])
    template = text.name if isinstance(text, Atom) else text.text if isinstance(text, String) else "~@"
    directives = (part.lstrip("0123456789*")[:1] for part in template.split("~")[1:])
    return sink in _TEXT_SINKS and not any(letter in ("p", "@") for letter in directives)


def _mentions(term: Term, keys: FrozenSet[Functor]) -> bool:
    """Return whether a functor occurs in a term."""
    return any(subterm.key in keys for subterm in subterms(wrap_term(term), 1, no_place))


def _name_of(event: Term) -> str:
    """Return the name of an event.

    Raises:
        _Unfollowed: if it is a variable.
    """
    key = functor_of(event)
    if key is None:
        raise _Unfollowed
    return key.name


def _awaited_names(pattern: Pattern) -> FrozenSet[str]:
    names = frozenset(
        _name_of(node.term) for node in walk(pattern, negated=True) if isinstance(node, EventPattern)
    )
    if _REV in names:
        raise _Unfollowed
    return names


def have_equal_files(old: ProgramVersion, new: ProgramVersion) -> bool:
    """Return whether the files of two versions are equal, and their results depend on no further files."""
    key = old.source_key()
    return key is not None and key == new.source_key()


def find_difference(old: ProgramVersion, new: ProgramVersion, bag: Bag) -> VersionDifference:
    """Return what has to be run of two versions to find all outputs that differ over a bag."""
    if have_equal_files(old, new):
        return VersionDifference(Extent.EQUAL)
    if (
        not (old.is_followed and new.is_followed)
        or old.settings != new.settings
        or old.topics.strings != new.topics.strings
    ):
        return VersionDifference(Extent.WHOLE)
    return _find_part(old, new, bag)


def _find_part(old: ProgramVersion, new: ProgramVersion, bag: Bag) -> VersionDifference:
    """Return the difference of two versions whose rules affect each other by events only."""
    predicates = {key for key in {*old.clauses, *new.clauses} if old.clauses.get(key) != new.clauses.get(key)}
    topics = _list_topics(old.topics) ^ _list_topics(new.topics)
    published = {strip_slashes(topic) for topic, _ in {*old.topics.published} ^ {*new.topics.published}}
    has_equal_consumers = [each.key for each in old.consumers] == [each.key for each in new.consumers]
    if has_equal_consumers and not (predicates or topics or published):
        return VersionDifference(Extent.EQUAL)
    old_consumers, new_consumers = (_select_possible(version, bag) for version in (old, new))
    consumers = [*old_consumers, *new_consumers]
    reached = _select_different(old_consumers, new_consumers)
    reached |= {
        consumer
        for consumer in consumers
        if consumer.predicates & predicates or consumer.output_topic in published
    }
    names = {topic.event for topic in topics}
    _close(consumers, reached, names, lambda consumer: consumer.awaited, lambda consumer: consumer.raised)
    # A topic that only one version reads may have an unexpected type, which is an error.
    if not reached and _list_available_topics(bag).isdisjoint(topic.topic for topic in topics):
        return VersionDifference(Extent.UNREACHED)
    # Outputs of a topic are compared with each other.
    output_topics = {consumer.output_topic for consumer in reached if consumer.output_topic}
    reached |= {consumer for consumer in consumers if consumer.output_topic in output_topics}
    needed_names: Set[str] = set()
    _close(
        consumers, reached, needed_names, lambda consumer: consumer.raised, lambda consumer: consumer.awaited
    )
    if len(reached) == len(old.consumers) + len(new.consumers):
        return VersionDifference(Extent.WHOLE)
    return VersionDifference(
        Extent.PART,
        tuple(_create_part(version, reached) for version in (old, new)),
        frozenset(needed_names),
    )


def _create_part(version: ProgramVersion, selected: Set[_SliceItem]) -> VersionPart:
    items = [consumer.item for consumer in version.consumers if consumer in selected]
    return VersionPart(
        frozenset(item for item in items if isinstance(item, EventRule)),
        frozenset(item for item in items if not isinstance(item, EventRule)),
    )


class _TopicEvents(NamedTuple):
    """Full name and type of a topic, and the name of its events."""

    topic: str
    type: str
    event: str


def _list_topics(topics: Topics) -> Set[_TopicEvents]:
    """Return the subscribed topics; of several entries for a topic, the first counts."""
    first: Dict[str, _TopicEvents] = {}
    for topic in topics.subscribed:
        name = strip_slashes(topic.topic)
        first.setdefault(name, _TopicEvents(name, topic.type, topics.functor_name_of(topic, strip_slashes)))
    return set(first.values())


def _list_available_topics(bag: Bag) -> Set[str]:
    """Return the full names of the topics of a bag."""
    return set(map(strip_slashes, list_topic_names(bag)))


def _select_possible(version: ProgramVersion, bag: Bag) -> List[_SliceItem]:
    """Return the rules and subscriptions that may receive all events that they need from a bag."""
    available = _list_available_topics(bag)
    names = {key.name for key in OWN_EVENTS}
    for topic in _list_topics(version.topics):
        # The events of an action come from several topics.
        if topic.topic in available or find_action_event(topic.type) is not None:
            names.add(topic.event)
    waiting = _group_by_name(version.consumers, lambda consumer: consumer.awaited)
    possible: Set[_SliceItem] = set()
    new_names = list(names)
    while new_names:
        for consumer in waiting.get(new_names.pop(), ()):
            if consumer not in possible and _can_match(consumer.pattern, names):
                possible.add(consumer)
                new_names += consumer.raised - names
                names |= consumer.raised
    return [consumer for consumer in version.consumers if consumer in possible]


def _can_match(pattern: Pattern, names: Set[str]) -> bool:
    """Return whether a pattern can match if only events of some names occur."""
    if isinstance(pattern, EventPattern):
        return _name_of(pattern.term) in names
    if isinstance(pattern, OrPattern):
        return any(_can_match(branch, names) for branch in pattern.branches)
    if isinstance(pattern, PairPattern):
        return _can_match(pattern.left, names) and _can_match(pattern.right, names)
    # All other patterns need their first operand only.
    return _can_match(children(pattern)[0], names)


def _select_different(old: Sequence[_SliceItem], new: Sequence[_SliceItem]) -> Set[_SliceItem]:
    """Return what only one version has at its place in the order.

    Rules fire in their order, so equal rules in another order are different: all that are not in one of the longest
    sequences that both versions have in common.
    """
    positions: Dict[Hashable, List[int]] = {}
    for position in reversed(range(len(old))):
        positions.setdefault(old[position].key, []).append(position)
    pairs = [
        (positions[consumer.key].pop(), position)
        for position, consumer in enumerate(new)
        if positions.get(consumer.key)
    ]
    different = {*old, *new}
    for old_position, new_position in _find_longest_increasing(pairs):
        different -= {old[old_position], new[new_position]}
    return different


def _find_longest_increasing(pairs: Sequence[Tuple[int, int]]) -> Iterator[Tuple[int, int]]:
    """Yield one of the longest subsequences whose first numbers increase, from its end (patience sorting)."""
    # For each length, the subsequence of that length with the smallest last number.
    last_numbers: List[int] = []
    last_indexes: List[int] = []
    previous: List[int] = []
    for index, (number, _) in enumerate(pairs):
        length = bisect_left(last_numbers, number)
        previous.append(last_indexes[length - 1] if length else -1)
        last_numbers[length : length + 1] = [number]
        last_indexes[length : length + 1] = [index]
    index = last_indexes[-1] if last_indexes else -1
    while index >= 0:
        yield pairs[index]
        index = previous[index]


ReadNames = Callable[[_SliceItem], FrozenSet[str]]


def _group_by_name(consumers: Iterable[_SliceItem], read_names: ReadNames) -> Dict[str, List[_SliceItem]]:
    groups: Dict[str, List[_SliceItem]] = {}
    for consumer in consumers:
        for name in read_names(consumer):
            groups.setdefault(name, []).append(consumer)
    return groups


def _close(
    consumers: Iterable[_SliceItem],
    selected: Set[_SliceItem],
    names: Set[str],
    read_triggers: ReadNames,
    read_results: ReadNames,
) -> None:
    """Select the consumers with a trigger among some names, and so on with the results of all selected ones.

    Args:
        consumers: all rules and subscriptions.
        selected: those that are selected already; the others are added.
        names: the names; the results are added.
        read_triggers: returns the triggers of a consumer.
        read_results: returns the results of a consumer.
    """
    groups = _group_by_name(consumers, read_triggers)
    pending = [*selected, *(consumer for name in names for consumer in groups.get(name, ()))]
    done: Set[_SliceItem] = set()
    while pending:
        consumer = pending.pop()
        if consumer in done:
            continue
        done.add(consumer)
        selected.add(consumer)
        new_names = read_results(consumer) - names
        names |= new_names
        pending += [other for name in new_names for other in groups.get(name, ())]


def reduce_to_part(engine: Engine, part: VersionPart) -> None:
    """Remove the rules and subscriptions of a loaded program that are not in a part."""
    program = engine.program
    for rule in program.rules.rules:
        if rule not in part.rules:
            program.rules.remove(rule)
    subscriptions = program.knowledge.subscriptions
    subscriptions.detach([key for key, _ in subscriptions.items() if key not in part.subscriptions])
    subscriptions.discard_detached()
