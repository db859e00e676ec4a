"""What is wrong with the times of rules: events that fire themselves, sides that never meet, windows.

Timers that are told to ring at what is no time.
"""

from collections import Counter
from itertools import combinations_with_replacement
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple

from ...foundation.errors import Place, RuleError
from ...prolog.terms.term_traversal import copy, term_key, variables
from ...prolog.terms.types import Functor, Term, Trail, atom, deref, functor
from ...prolog.terms.unification import undo, unify
from ..language.pattern_operators import OPERATORS, SPELLINGS
from ..language.pattern_tree import (
    Absent,
    Action,
    Aggregate,
    Awaited,
    Condition,
    Either,
    Occurs,
    Pair,
    Pattern,
    Repeated,
    RuleDefinition,
    Shaped,
    Star,
    Windowed,
    Within,
    bound_by,
    children,
    occurrences,
)
from ..language.rule_parser import ALARMS, TIMER, made_by, schedule_fault
from .program_model import ProgramModel, WrittenRule, held, inners, key_of

DAY = 86_400
_UNITS = "spans are in seconds"
_NEW = functor("new_event", 3)
_UNRESTRICTED, _RECENT, _OFF = atom("unrestricted"), atom("recent"), atom("off")


class _Trigger(NamedTuple):
    """A rule that an event fires by itself, as soon as it happens."""

    rule: WrittenRule
    head: Term
    event: Term


def cycles(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the rules by which an event fires itself, at once and without end."""
    steps = _in_turn([step for rule in program.rules for step in _steps(rule)])
    of_event = _by_event(steps)
    said: Set[int] = set()
    for at, step in enumerate(steps):
        way = None if at in said else _way_back(steps, of_event, at)
        if way is None or any(one in said for one in way):
            continue
        said.update(way)
        names = " <- ".join(str(key_of(steps[one].head)) for one in reversed([*way, way[0]]))
        what = (
            f"{key_of(step.head)} fires itself"
            if len(way) == 1
            else f"these events fire each other ({names})"
        )
        yield RuleError(
            f"{what}, at once and without end: give the rule a condition (where) or another head",
            step.rule.definition.place,
        )


def _steps(rule: WrittenRule) -> Iterator[_Trigger]:
    head = rule.definition.head
    if head is None or key_of(head) in ALARMS or made_by(head) is not deref(head):
        return
    for event in _alone(rule.definition.pattern):
        if key_of(event) is not None and key_of(head) is not None:
            yield _Trigger(rule, head, event)


def _alone(pattern: Pattern) -> Iterator[Term]:
    """Yield the events that match a pattern by themselves, under no condition."""
    if isinstance(pattern, Occurs):
        yield pattern.term
    elif isinstance(pattern, Either):
        for branch in pattern.branches:
            yield from _alone(branch)
    elif isinstance(pattern, Within) or (isinstance(pattern, Action) and not pattern.every):
        yield from _alone(pattern.pattern)


def _by_event(steps: List[_Trigger]) -> Dict[Optional[Functor], List[int]]:
    """Return the places of the steps that events of a functor start."""
    found: Dict[Optional[Functor], List[int]] = {}
    for at, step in enumerate(steps):
        found.setdefault(key_of(step.event), []).append(at)
    return found


def _in_turn(steps: List[_Trigger]) -> List[_Trigger]:
    """Return the steps that may lead to themselves: without those whose event none of the others fires."""
    makers = Counter(key_of(step.head) for step in steps)
    of_event = _by_event(steps)
    gone: Set[int] = set()
    left = [key for key in of_event if not makers[key]]
    while left:
        for at in of_event.get(left.pop(), ()):
            gone.add(at)
            key = key_of(steps[at].head)
            makers[key] -= 1
            if not makers[key]:
                left.append(key)
    return [step for at, step in enumerate(steps) if at not in gone]


def _way_back(
    steps: List[_Trigger], of_event: Dict[Optional[Functor], List[int]], start: int
) -> Optional[List[int]]:
    """Return the steps by which the event of a step leads to itself again, the shortest way; None for no way."""
    before: Dict[int, int] = {}
    level = [start]
    while level:
        following = []
        for at in level:
            for other in of_event.get(key_of(steps[at].head), ()):
                step = steps[other]
                if other == start and _leads(steps[at], step):
                    way = [at]
                    while way[-1] != start:
                        way.append(before[way[-1]])
                    return way[::-1]
                if other not in before and other != start and _leads(steps[at], step):
                    before[other] = at
                    following.append(other)
        level = following
    return None


def _leads(one: _Trigger, other: _Trigger) -> bool:
    trail: Trail = []
    fits = unify(copy(one.head), copy(other.event), trail)
    undo(trail, 0)
    return bool(fits)


# ---- sides that never meet -----------------------------------------------------------------------------


_INSTANTS = [(at, at) for at in range(3)]
_INTERVALS = list(combinations_with_replacement(range(5), 2))


def never_meet(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the pairs whose intervals can never lie as their operator asks: one side is always an instant."""
    instants = _Instants(program)
    for rule in program.rules:
        for node in _nodes(rule.definition.pattern):
            if isinstance(node, Pair) and node.operator in OPERATORS:
                left, right = instants.holds(node.left), instants.holds(node.right)
                if (left or right) and not _fits(node.operator, left, right):
                    which = (
                        "both sides are instants"
                        if left and right
                        else f"the {'left' if left else 'right'} side is an instant"
                    )
                    yield RuleError(
                        f"{node.operator} never matches here: {which}, and "
                        f"{OPERATORS[node.operator].name} {_ASKS.get(node.operator, 'asks for intervals')}",
                        _operator_place(rule, node.operator),
                    )


_ASKS = {
    "par": "asks for two that overlap by more than an instant: write and, or seq",
    "starts": "asks for two that start together and end one after the other",
    "finishes": "asks for two that end together and started one after the other",
}


def _fits(operator: str, left: bool, right: bool) -> bool:
    """Tell whether the comparisons of an operator hold for any two intervals of these kinds."""
    comparisons = OPERATORS[operator].comparisons
    for s1, e1 in _INSTANTS if left else _INTERVALS:
        for s2, e2 in _INSTANTS if right else _INTERVALS:
            values = {"s1": s1, "e1": e1, "s2": s2, "e2": e2}
            if all(_holds(comparison, values) for comparison in comparisons):
                return True
    return False


def _holds(comparison: str, values: Dict[str, int]) -> bool:
    left, sign, right = comparison.split()
    one, other = values[left], values[right]
    return {"<": one < other, "<=": one <= other, "==": one == other}[sign]


class _Instants:
    """Which events are instants, whatever happens: messages, alarms, and rules that have one such event."""

    def __init__(self, program: ProgramModel):
        self._program = program
        self._rules: Dict[Functor, List[WrittenRule]] = {}
        self._goals: Set[Functor] = set()
        for rule in program.rules:
            key = None if rule.definition.head is None else key_of(made_by(rule.definition.head))
            if key is not None:
                self._rules.setdefault(key, []).append(rule)
        for inner in program.calls():
            term = inner.term
            if (
                term.__class__ is tuple
                and term[0].name in ("new_event", "event", "input_event")
                and len(term) > 1
            ):
                key = key_of(term[1])
                if key is not None and term[0] is not _NEW:
                    self._goals.add(key)
                elif key is None:
                    self._goals.add(_ANY)

        self._known = self._fired_at_once()

    def holds(self, pattern: Pattern) -> bool:
        """Tell whether each match of a pattern is an instant."""
        events = _single(pattern)
        return events is not None and all(key in self._known or self._is_message(key) for key in events)

    def _is_message(self, key: Functor) -> bool:
        return key not in self._rules and _is_message(self._program, key)

    def _fired_at_once(self) -> Set[Functor]:
        """Return the events of rules all of which have one event each, an instant; long chains of rules, too."""
        missing: Dict[Functor, Set[Functor]] = {}
        waiting: Dict[Functor, List[Functor]] = {}
        for key, rules in self._rules.items():
            needed = None if key in self._goals or _ANY in self._goals else _needed(rules)
            if needed is not None:
                missing[key] = {one for one in needed if not self._is_message(one)}
                for one in missing[key]:
                    waiting.setdefault(one, []).append(key)
        known: Set[Functor] = set()
        ready = [key for key, needed in missing.items() if not needed]
        while ready:
            found = ready.pop()
            known.add(found)
            for key in waiting.get(found, ()):
                missing[key].discard(found)
                if not missing[key]:
                    ready.append(key)
        return known


def _is_message(program: ProgramModel, key: Functor) -> bool:
    """Test whether events of a functor are messages of a topic that the program subscribes to."""
    kind = program.type_of(key.name)
    topics = (*program.topics.subscribed, *program.direct)
    return kind is not None and any(one == kind for _, one in topics)


def _needed(rules: List[WrittenRule]) -> Optional[Set[Functor]]:
    """Return which events have to be instants for those of rules to be; None where these may not be in any case."""
    found: Set[Functor] = set()
    for rule in rules:
        head: Any = rule.definition.head
        events = _single(rule.definition.pattern) if made_by(head) is deref(head) else None
        if events is None:
            return None
        found.update(events)
    return found


def _single(pattern: Pattern) -> Optional[Set[Functor]]:
    """Return the events of which one is a match of a pattern; None where it takes several, or any."""
    found: Set[Functor] = set()
    stack: List[Pattern] = [pattern]
    while stack:
        part = stack.pop()
        key = key_of(part.term) if isinstance(part, Occurs) else None
        if key is not None:
            found.add(key)
        elif isinstance(part, (Either, Condition, Within, Action)):
            stack += children(part)
        else:
            return None
    return found


_ANY = functor("$any", 0)


# ---- windows -------------------------------------------------------------------------------------------


def windows(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the spans that are hardly meant: zero, or beyond a day."""
    for rule in program.rules:
        for inner in inners(held(rule.definition.term), 1, rule.spot):
            term = inner.term
            if term.__class__ is tuple and SPELLINGS.get(term[0]) == "within" and len(term) == 3:
                wrong = _long(deref(term[2]))
                if wrong:
                    yield RuleError(f"within {wrong}", rule.spot(term, 2))
    labels = {
        term_key(rule.definition.label): rule for rule in program.rules if rule.definition.label is not None
    }
    for key, properties in program.loaded.all_properties().items():
        for one in properties:
            wrong = ""
            if one.known and one.word is None and "step" not in one.name:
                wrong = "0: nothing but instants is ever matched" if one.number == 0 else _long(one.number)
                wrong = "" if one.name == "ttl" else wrong
            if wrong:
                at = labels.get(key)
                yield RuleError(f"{one.name} {wrong}", None if at is None else at.definition.place)


def _long(span: Any) -> str:
    if span.__class__ not in (int, float) or not span > DAY:
        return ""
    return f"{span} is {span / DAY:.3g} days: {_UNITS}"


def waits_for_ever(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the rules whose partial matches are never dropped: the policy takes none of them away, nor does time."""
    flags = program.loaded.flags
    if flags.get("garbage_control") is not _OFF:
        return
    properties = program.loaded.all_properties()
    for rule in program.rules:
        label = rule.definition.label
        said = {} if label is None else {one.name: one.value for one in properties.get(term_key(label), ())}
        policy = said.get("policy", flags.get("event_consumption_policy"))
        if policy is not _UNRESTRICTED or any("window" in name for name in said):
            continue
        node = _unbounded(rule.definition.pattern)
        if node is not None:
            operator = node.operator if isinstance(node, Pair) else "seq"
            yield RuleError(
                "what waits here is kept for ever: the policy is unrestricted, and no window ends it; "
                "write (...) within SECONDS, or turn on garbage_control",
                _operator_place(rule, operator),
            )


def unbounded_keys(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the operators on streams that keep a state for each value of a variable, which no time ends.

    A rule whose label has a time to live is not reported, also if that is 0: its state is intended.
    """
    flags = program.loaded.flags
    bounds = flags.key_bounds()
    if flags.get("garbage_control") is not _OFF or bounds.idle is not None:
        return
    properties = program.loaded.all_properties()
    for rule in program.rules:
        label = rule.definition.label
        said = () if label is None else properties.get(term_key(label), ())
        if any(one.name in ("window", "event_rule_window", "ttl") for one in said):
            continue
        for part in _not_within(rule.definition.pattern):
            if _has_unbounded_keys(part, rule.definition):
                yield RuleError(
                    f"no time ends the state that is kept here for each key, up to {bounds.keys} keys; write (...) "
                    "within SECONDS, or give the rule a label with property(ttl, SECONDS), or property(ttl, 0) if "
                    "the keys are few",
                    _operator_place(rule, "with") if isinstance(part, Shaped) else _aggregate_place(rule),
                )


def _not_within(pattern: Pattern) -> Iterator[Pattern]:
    """Yield the operators on streams around which there is no ``within``."""
    stack: List[Tuple[Any, bool]] = [(pattern, False)]
    while stack:
        part, limited = stack.pop()
        if isinstance(part, (Windowed, Shaped, Awaited)):
            if not limited:
                yield part
            limited = False  # a span is about what an operator gives, not about what comes to it
        elif isinstance(part, Within):
            limited = True
        stack += [(below, limited) for below in reversed(children(part, False))]
        if isinstance(part, (Absent, Awaited)):
            stack.append((part.negated, False))


def _has_unbounded_keys(part: Pattern, definition: RuleDefinition) -> bool:
    """Test whether an operator keeps a state for each value of a variable."""
    if isinstance(part, Shaped):
        return part.shape == "change" and any(variables(term) for term in part.by)
    if not isinstance(part, Windowed) or part.window.kind not in ("newest", "batch", "steps"):
        return False
    measured = [value for value in part.values if value is not None]
    inside = occurrences([*measured, *part.window.looked_at], part.collected)
    head = [] if definition.head is None else [definition.head]
    everywhere = occurrences(head, definition.pattern)
    return any(everywhere[var] > inside.get(var, 0) for var in bound_by(part.collected))


def _aggregate_place(rule: WrittenRule) -> Optional[Place]:
    """Return where the first aggregate stands in a rule."""
    for inner in inners(held(rule.definition.term), 1, rule.spot):
        if inner.term.__class__ is tuple and inner.term[0].name == "aggregate":
            return inner.place
    return rule.definition.place


def missed_pairs(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the pairs of messages within a span that the default policy uses once, so that close pairs are missed.

    A rule whose label names a policy is not reported: its policy is intended.
    """
    if program.loaded.flags.get("event_consumption_policy") is not _RECENT:
        return
    properties = program.loaded.all_properties()
    for rule in program.rules:
        label = rule.definition.label
        said = () if label is None else properties.get(term_key(label), ())
        if not any(one.name == "policy" for one in said) and _pairs_messages(
            program, rule.definition.pattern
        ):
            yield RuleError(
                "under the policy recent a message is used for one pair only, so messages of topics with different "
                "rates miss partners within the time; for all pairs give the rule a label with "
                "property(policy, unrestricted), or property(policy, recent) if this is intended",
                _operator_place(rule, "and"),
            )


def _pairs_messages(program: ProgramModel, pattern: Pattern) -> bool:
    """Test whether a pattern joins messages of two topics by ``and`` within a span."""
    for node in _nodes(pattern):
        if not isinstance(node, Within):
            continue
        limited = node.pattern
        while isinstance(limited, (Within, Condition)):
            limited = limited.pattern
        if isinstance(limited, Pair) and limited.operator == "and":
            sides = [_single(limited.left), _single(limited.right)]
            if all(keys and all(_is_message(program, key) for key in keys) for keys in sides):
                return True
    return False


def _unbounded(pattern: Pattern) -> Optional[Pattern]:
    """Return the first part of a pattern that joins events and is not within a span."""
    stack: List[Any] = [pattern]
    while stack:
        part = stack.pop()
        if isinstance(part, Within):
            continue
        if isinstance(part, (Pair, Star, Aggregate, Repeated)):
            found: Pattern = part
            return found
        stack += reversed(children(part, False))
    return None


def _nodes(pattern: Pattern) -> Iterator[Pattern]:
    stack: List[Any] = [pattern]
    while stack:
        part = stack.pop()
        yield part
        stack += reversed(children(part))


def _operator_place(rule: WrittenRule, operator: str) -> Optional[Place]:
    """Return where an operator stands first in a rule."""
    for inner in inners(held(rule.definition.term), 1, rule.spot):
        if inner.term.__class__ is tuple and SPELLINGS.get(inner.term[0]) == operator:
            return inner.place
    return rule.definition.place


def timers(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the goals that set a timer and say when as no timer can be told."""
    if not program.logic.is_of_system(TIMER):
        return
    for inner in program.called():
        fault = schedule_fault(inner.term[2]) if inner.key is TIMER else None
        if fault is not None:
            text = f"timer/2: {fault}, found {program.logic.brief(inner.term[2], program.names)}"
            yield RuleError(text, inner.spot(inner.term, 2))
