"""What there is of a program at one moment, and what one load of its folder has made of that."""

from pathlib import Path
from typing import Callable, Dict, Hashable, List, NamedTuple, Optional, Sequence, Set, Tuple, TypeVar

from ..events.knowledge import DeclaredState, Instance, Knowledge, Subscription, SubscriptionKey
from ..events.language import Property
from ..events.network import Rule
from ..events.rules import ProgramTimer, Rules
from ..prolog.database import Clause, Predicate
from ..prolog.logic import Logic
from ..prolog.terms import Functor, Term, functor, term_key

_CLAUSE = functor(":-", 2)

Key = TypeVar("Key", bound=Hashable)
Clauses = Dict[Predicate, List[Clause]]


class Standing(NamedTuple):
    """What there is of a program.

    Attributes:
        rules: the event rules, in order.
        clauses: of each predicate that is not the system's, in order.
        memories: by their ids.
        subscriptions: by topic and id.
        properties: of labels.
        flags: those of ``set_etalis_flag/2``.
        dynamic: the predicates that are declared so.
        replaced: the predicates of the library that the program has of its own.
        files: those that have been loaded.
        timers: by their keys.
        states: by their keys.
    """

    rules: List[Rule]
    clauses: Clauses
    memories: Dict[Hashable, Instance]
    subscriptions: Dict[SubscriptionKey, Subscription]
    properties: Dict[Hashable, List[Property]]
    flags: Dict[str, Optional[Term]]
    dynamic: Set[Predicate]
    replaced: Set[Functor]
    files: Set[Path]
    timers: Dict[Hashable, ProgramTimer]
    states: Dict[Hashable, DeclaredState]

    def since(self, before: "Standing") -> "Standing":
        """Return what has come since a moment before."""
        rules, files = set(before.rules), before.files
        clauses = {one: _without(found, before.clauses.get(one, ())) for one, found in self.clauses.items()}
        properties = {
            key: [one for one in found if one not in before.properties.get(key, ())]
            for key, found in self.properties.items()
        }
        return Standing(
            [rule for rule in self.rules if rule not in rules],
            {one: found for one, found in clauses.items() if found},
            _new_in(self.memories, before.memories),
            _new_in(self.subscriptions, before.subscriptions),
            {key: found for key, found in properties.items() if found},
            {name: value for name, value in self.flags.items() if value != before.flags[name]},
            self.dynamic - before.dynamic,
            self.replaced - before.replaced,
            self.files - files,
            _new_in(self.timers, before.timers),
            _new_in(self.states, before.states),
        )

    def and_then(self, other: "Standing") -> "Standing":
        """Return what this and a later load have made."""
        clauses = {one: [*self.clauses.get(one, ()), *found] for one, found in other.clauses.items()}
        properties = {key: [*self.properties.get(key, ()), *found] for key, found in other.properties.items()}
        return Standing(
            [*self.rules, *other.rules],
            {**self.clauses, **clauses},
            {**self.memories, **other.memories},
            {**self.subscriptions, **other.subscriptions},
            {**self.properties, **properties},
            {**self.flags, **other.flags},
            self.dynamic | other.dynamic,
            self.replaced | other.replaced,
            self.files | other.files,
            {**self.timers, **other.timers},
            {**self.states, **other.states},
        )


NOTHING = Standing([], {}, {}, {}, {}, {}, set(), set(), set(), {}, {})
"""What a program has made that was not loaded."""


def standing(logic: Logic, rules: Rules, knowledge: Knowledge) -> Standing:
    """Return what there is of an engine's program now."""
    database = logic.database
    found = [one.tabled or one for one in list(database.predicates.values())]
    own = [one for one in found if one.kind == "user" and not one.library]
    return Standing(
        rules.rules,
        {predicate: list(predicate.live()) for predicate in own},
        dict(knowledge.memories.instances),
        dict(knowledge.subscriptions.items()),
        rules.all_properties(),
        {name: rules.flags.get(name) for name in rules.flags.names()},
        {one for one in found if one.dynamic and not one.library},
        set(database.library.kept),
        set(rules.files.loaded),
        rules.timers.standing(),
        knowledge.states.standing(),
    )


def clause_key(clause: Clause) -> Hashable:
    """Return what is equal for clauses that are the same but for the names of variables."""
    return term_key((_CLAUSE, clause.head, clause.body))


def paired(old: Sequence[Rule], new: Sequence[Rule], key: Callable[[Rule], Hashable]) -> Dict[Rule, Rule]:
    """Return for new rules the old ones that say the same, each once, the first ones first."""
    waiting: Dict[Hashable, List[Rule]] = {}
    for rule in reversed(old):
        waiting.setdefault(key(rule), []).append(rule)
    found: List[Tuple[Rule, Rule]] = []
    for rule in new:
        same = waiting.get(key(rule))
        if same:
            found.append((rule, same.pop()))
    return dict(found)


def _without(clauses: List[Clause], others: Sequence[Clause]) -> List[Clause]:
    known = set(others)
    return [clause for clause in clauses if clause not in known]


Item = TypeVar("Item")


def _new_in(items: Dict[Key, Item], before: Dict[Key, Item]) -> Dict[Key, Item]:
    return {key: one for key, one in items.items() if before.get(key) is not one}
