"""Deployments: the rules, clauses and other items of a program, and the part that one folder has created.

A deployment (Esper's term for everything that one load has created) is the difference between two states of the
program: `standing` reads all items, and `Deployment.since` subtracts an earlier state. A reload replaces exactly the
items of the folder's deployment. In a saved state, items are referred to by their positions in the program's lists.
"""

from pathlib import Path
from typing import Any, Callable, Dict, Hashable, List, NamedTuple, Optional, Sequence, Set, Tuple, TypeVar

from ..events.knowledge.event_states import DeclaredState
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.memory import MemoryInstance
from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.language.rule_parser import Property
from ..events.network.event_rule import EventRule
from ..events.rules.rule_base import RuleBase
from ..events.rules.timer_service import ProgramTimer, Timers
from ..prolog.database.clause_index import Clause
from ..prolog.database.predicate import Predicate
from ..prolog.system.logic_state import program_predicates
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.types import Functor, Term, functor

_CLAUSE = functor(":-", 2)

ItemKey = TypeVar("ItemKey", bound=Hashable)
Clauses = Dict[Predicate, List[Clause]]


class Deployment(NamedTuple):
    """Items of a program.

    Attributes:
        rules: event rules, in order.
        clauses: clauses in order, by predicate; without the system's predicates.
        memories: memories by id.
        subscriptions: subscriptions by topic and id.
        properties: properties by label.
        flags: flags of ``set_etalis_flag/2``.
        dynamic: predicates that are declared dynamic.
        replaced: library predicates that the program redefines.
        files: loaded files.
        timers: timers by key.
        states: declared states by key.
    """

    rules: List[EventRule]
    clauses: Clauses
    memories: Dict[Hashable, MemoryInstance]
    subscriptions: Dict[SubscriptionKey, Subscription]
    properties: Dict[Hashable, List[Property]]
    flags: Dict[str, Optional[Term]]
    dynamic: Set[Predicate]
    replaced: Set[Functor]
    files: Set[Path]
    timers: Dict[Hashable, ProgramTimer]
    states: Dict[Hashable, DeclaredState]

    def since(self, before: "Deployment") -> "Deployment":
        """Return the items that were added after an earlier state."""
        # Items are compared by identity, not by equality: an item that was deleted and defined again is a new one.
        rules, files = set(before.rules), before.files
        clauses = {one: _without(found, before.clauses.get(one, ())) for one, found in self.clauses.items()}
        properties = {
            key: [one for one in found if one not in before.properties.get(key, ())]
            for key, found in self.properties.items()
        }
        return Deployment(
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

    def and_then(self, other: "Deployment") -> "Deployment":
        """Return the union of this deployment and a later one."""
        clauses = {one: [*self.clauses.get(one, ()), *found] for one, found in other.clauses.items()}
        properties = {key: [*self.properties.get(key, ()), *found] for key, found in other.properties.items()}
        return Deployment(
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


NOTHING = Deployment([], {}, {}, {}, {}, {}, set(), set(), set(), {}, {})
"""The empty deployment."""


def standing(logic: PrologSystem, rules: RuleBase, knowledge: KnowledgeBase) -> Deployment:
    """Return all items of an engine's program."""
    database = logic.database
    # A tabled predicate is wrapped; its clauses belong to the inner predicate.
    found = [one.tabled or one for one in list(database.predicates.values())]
    own = [one for one in found if one.kind == "user" and not one.library]
    return Deployment(
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
    """Return a key that is equal for clauses that differ only in the names of variables."""
    return term_key((_CLAUSE, clause.head, clause.body))


def paired(
    old: Sequence[EventRule], new: Sequence[EventRule], key: Callable[[EventRule], Hashable]
) -> Dict[EventRule, EventRule]:
    """Pair new rules with equal old rules, in order; each old rule is used once."""
    waiting: Dict[Hashable, List[EventRule]] = {}
    # In reverse order, so that `pop` returns the first of several equal rules.
    for rule in reversed(old):
        waiting.setdefault(key(rule), []).append(rule)
    found: List[Tuple[EventRule, EventRule]] = []
    for rule in new:
        same = waiting.get(key(rule))
        if same:
            found.append((rule, same.pop()))
    return dict(found)


def _without(clauses: List[Clause], others: Sequence[Clause]) -> List[Clause]:
    known = set(others)
    return [clause for clause in clauses if clause not in known]


Item = TypeVar("Item")


def _new_in(items: Dict[ItemKey, Item], before: Dict[ItemKey, Item]) -> Dict[ItemKey, Item]:
    return {key: one for key, one in items.items() if before.get(key) is not one}


def keep_standings(
    programs: Dict[str, Deployment], logic: PrologSystem, knowledge: KnowledgeBase, named: List[EventRule]
) -> Dict[str, Any]:
    """Return the deployments as data for a saved state."""
    rules = {id(rule): at for at, rule in enumerate(named)}
    predicates = program_predicates(logic)
    clauses = {id(one): at for found in predicates for at, one in enumerate(found.live())}
    memories = {id(one): at for at, one in enumerate(knowledge.memories)}
    subscriptions = {id(one): at for at, (_, one) in enumerate(knowledge.subscriptions.items())}
    states = {id(one): at for at, one in enumerate(knowledge.states)}
    return {
        folder: {
            "rules": [rules[id(rule)] for rule in made.rules if id(rule) in rules],
            "clauses": [
                (one.functor, [clauses[id(clause)] for clause in found if id(clause) in clauses])
                # A retracted clause has no position any more. It is saved in full, because a reload compares the
                # clauses that it has loaded with those that still exist, see `ReloadTransaction._leave_retracted`.
                for one, found in made.clauses.items()
            ],
            "retracted": [
                (
                    one.functor,
                    [
                        (clause.head, clause.body, clause.place)
                        for clause in found
                        if id(clause) not in clauses
                    ],
                )
                for one, found in made.clauses.items()
            ],
            "memories": [memories[id(one)] for one in made.memories.values() if id(one) in memories],
            "subscriptions": [
                subscriptions[id(one)] for one in made.subscriptions.values() if id(one) in subscriptions
            ],
            "properties": [one for found in made.properties.values() for one in found],
            "flags": made.flags,
            "dynamic": [one.functor for one in made.dynamic],
            "replaced": list(made.replaced),
            "files": sorted(map(str, made.files)),
            "declared": [states[id(one)] for one in made.states.values() if id(one) in states],
            "timers": [(one.event, one.schedule.term) for one in made.timers.values()],
        }
        for folder, made in programs.items()
    }


def restore_standings(
    kept: Dict[str, Any],
    logic: PrologSystem,
    knowledge: KnowledgeBase,
    timers: Timers,
    named: List[EventRule],
) -> Dict[str, Deployment]:
    """Return the deployments from a saved state.

    One-shot timers that have fired since are omitted.
    """
    memories = list(knowledge.memories.instances.items())
    subscriptions = knowledge.subscriptions.items()
    states = list(knowledge.states.standing().items())
    found = {}
    for folder, made in kept.items():
        properties: Dict[Hashable, List[Property]] = {}
        for one in made["properties"]:
            properties.setdefault(term_key(one.label), []).append(one)
        found[folder] = Deployment(
            [named[at] for at in made["rules"]],
            _clauses(logic, made),
            dict(memories[at] for at in made["memories"]),
            dict(subscriptions[at] for at in made["subscriptions"]),
            properties,
            made["flags"],
            {_predicate(logic, functor) for functor in made["dynamic"]},
            set(made["replaced"]),
            set(map(Path, made["files"])),
            {one.key: one for one in (timers.find(*said) for said in made["timers"]) if one is not None},
            dict(states[at] for at in made["declared"]),
        )
    return found


def _predicate(logic: PrologSystem, functor: Functor) -> Predicate:
    found = logic.database.predicate(functor)
    return found.tabled or found


def _clauses(logic: PrologSystem, made: Dict[str, Any]) -> Dict[Predicate, List[Clause]]:
    """Return a deployment's clauses by predicate: existing clauses first, then retracted ones."""
    clauses: Dict[Predicate, List[Clause]] = {}
    for key, places in made["clauses"]:
        predicate = _predicate(logic, key)
        live = list(predicate.live())
        clauses[predicate] = [live[at] for at in places]
    for key, gone in made["retracted"]:
        predicate = _predicate(logic, key)
        for head, body, place in gone:
            clause = Clause(predicate, head, body, place)
            # Marked as dead from the beginning, so that no goal sees the clause.
            clause.died = 0
            clauses.setdefault(predicate, []).append(clause)
    return clauses
