"""Items that one load has created: the rules, clauses and other items of a program, and the part of one folder.

A deployment (Esper's term for everything that one load has created) is the difference between two states of the
program: `current_deployment` reads all items, and `Deployment.added_since` subtracts an earlier state. A reload
replaces exactly the items of the folder's deployment. In a saved state, rules, clauses, memories, subscriptions and
states are positions in the program's lists; all other items are saved by value.
"""

from pathlib import Path
from typing import Callable, Dict, Hashable, List, NamedTuple, Optional, Sequence, Set, Tuple, TypeVar

from ..events.knowledge.event_states import DeclaredState
from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.memory import MemoryInstance
from ..events.knowledge.subscriptions import Subscription, SubscriptionKey
from ..events.language.rule_labels import Property
from ..events.network.event_rule import EventRule
from ..events.program.event_file_loader import EventFileLoader
from ..events.rules.program_timers import ProgramTimer, Timers
from ..events.rules.rule_base import RuleBase
from ..prolog.database.clause_index import Clause
from ..prolog.database.predicate import Predicate
from ..prolog.system.prolog_snapshot import CLAUSES, StoredClause, program_predicates
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.types import Functor, Term, functor
from ..serialization.state_fields import record_of
from ..serialization.stored_field_types import (
    COUNT,
    FUNCTOR,
    PATH,
    TERM,
    TEXT,
    mapping_of,
    optional,
    sequence_of,
    tuple_of,
)
from .rule_network_snapshot import PROPERTIES

_CLAUSE_FUNCTOR = functor(":-", 2)


class LoadedProgram(NamedTuple):
    """The program of an engine: its predicates, rules and knowledge, and the loader that adds to them."""

    logic: PrologSystem
    rules: RuleBase
    knowledge: KnowledgeBase
    loader: EventFileLoader


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

    def added_since(self, before: "Deployment") -> "Deployment":
        """Return the items that were added after an earlier state."""
        # Rules, clauses, memories, subscriptions, timers and states are compared by identity: one that was deleted
        # and defined again is new. The others are compared by value.
        previous_rules = set(before.rules)
        clauses = {
            predicate: _exclude(clause_list, before.clauses.get(predicate, ()))
            for predicate, clause_list in self.clauses.items()
        }
        properties = {
            key: [item for item in items if item not in before.properties.get(key, ())]
            for key, items in self.properties.items()
        }
        return Deployment(
            rules=[rule for rule in self.rules if rule not in previous_rules],
            clauses={predicate: clause_list for predicate, clause_list in clauses.items() if clause_list},
            memories=_select_new(self.memories, before.memories),
            subscriptions=_select_new(self.subscriptions, before.subscriptions),
            properties={key: items for key, items in properties.items() if items},
            flags={name: value for name, value in self.flags.items() if value != before.flags[name]},
            dynamic=self.dynamic - before.dynamic,
            replaced=self.replaced - before.replaced,
            files=self.files - before.files,
            timers=_select_new(self.timers, before.timers),
            states=_select_new(self.states, before.states),
        )

    def union(self, later: "Deployment") -> "Deployment":
        """Return the union of this deployment and a later one."""
        clauses = {
            predicate: [*self.clauses.get(predicate, ()), *clause_list]
            for predicate, clause_list in later.clauses.items()
        }
        properties = {key: [*self.properties.get(key, ()), *items] for key, items in later.properties.items()}
        return Deployment(
            rules=[*self.rules, *later.rules],
            clauses={**self.clauses, **clauses},
            memories={**self.memories, **later.memories},
            subscriptions={**self.subscriptions, **later.subscriptions},
            properties={**self.properties, **properties},
            flags={**self.flags, **later.flags},
            dynamic=self.dynamic | later.dynamic,
            replaced=self.replaced | later.replaced,
            files=self.files | later.files,
            timers={**self.timers, **later.timers},
            states={**self.states, **later.states},
        )


EMPTY_DEPLOYMENT = Deployment(
    rules=[],
    clauses={},
    memories={},
    subscriptions={},
    properties={},
    flags={},
    dynamic=set(),
    replaced=set(),
    files=set(),
    timers={},
    states={},
)


def current_deployment(program: LoadedProgram) -> Deployment:
    """Return all items of an engine's program."""
    rules, knowledge, database = program.rules, program.knowledge, program.logic.database
    # A tabled predicate is wrapped; its clauses belong to the inner predicate.
    predicates = [predicate.hidden_predicate or predicate for predicate in list(database.predicates.values())]
    own_predicates = [
        predicate
        for predicate in predicates
        if predicate.kind == "user" and not predicate.is_library_predicate
    ]
    return Deployment(
        rules=rules.rules,
        clauses={predicate: list(predicate.active_clauses()) for predicate in own_predicates},
        memories=dict(knowledge.memories.instances),
        subscriptions=dict(knowledge.subscriptions.items()),
        properties=rules.all_properties(),
        flags={name: rules.flags.get(name) for name in rules.flags.names()},
        dynamic={
            predicate for predicate in predicates if predicate.dynamic and not predicate.is_library_predicate
        },
        replaced=set(database.library.shadowed_predicates),
        files=set(rules.files.loaded),
        timers=rules.timers.all_by_key(),
        states=knowledge.states.all_by_key(),
    )


def clause_key(clause: Clause) -> Hashable:
    """Return a key that is equal for clauses that differ only in the names of variables."""
    return term_key((_CLAUSE_FUNCTOR, clause.head, clause.body))


def pair_equal_rules(
    old: Sequence[EventRule], new: Sequence[EventRule], key: Callable[[EventRule], Hashable]
) -> Dict[EventRule, EventRule]:
    """Return the equal old rule of each new rule that has one; each old rule is used once."""
    rules_by_key: Dict[Hashable, List[EventRule]] = {}
    # In reverse order, so that `pop` returns the first of several equal rules.
    for rule in reversed(old):
        rules_by_key.setdefault(key(rule), []).append(rule)
    pairs: List[Tuple[EventRule, EventRule]] = []
    for rule in new:
        equal_rules = rules_by_key.get(key(rule))
        if equal_rules:
            pairs.append((rule, equal_rules.pop()))
    return dict(pairs)


def _exclude(clauses: List[Clause], excluded: Sequence[Clause]) -> List[Clause]:
    excluded_clauses = set(excluded)
    return [clause for clause in clauses if clause not in excluded_clauses]


Item = TypeVar("Item")


def _select_new(items: Dict[ItemKey, Item], before: Dict[ItemKey, Item]) -> Dict[ItemKey, Item]:
    return {key: item for key, item in items.items() if before.get(key) is not item}


class StoredDeployment(NamedTuple):
    """Stored form of a `Deployment`; numbers are positions in the lists of the program.

    Attributes:
        clauses: by predicate, positions of its clauses.
        retracted: by predicate, clauses that are no longer part of it.
        memories, subscriptions, states: positions.
        properties, flags, replaced: as in `Deployment`.
        dynamic: functors of predicates.
        files: paths.
        timers: events and schedules.
    """

    rules: List[int]
    clauses: List[Tuple[Functor, List[int]]]
    retracted: List[Tuple[Functor, List[StoredClause]]]
    memories: List[int]
    subscriptions: List[int]
    properties: List[Property]
    flags: Dict[str, Optional[Term]]
    dynamic: List[Functor]
    replaced: List[Functor]
    files: List[str]
    states: List[int]
    timers: List[Tuple[Term, Term]]


_POSITIONS = sequence_of(COUNT)

DEPLOYMENTS = mapping_of(
    PATH,
    record_of(
        StoredDeployment,
        rules=_POSITIONS,
        clauses=sequence_of(tuple_of(FUNCTOR, _POSITIONS)),
        retracted=sequence_of(tuple_of(FUNCTOR, CLAUSES)),
        memories=_POSITIONS,
        subscriptions=_POSITIONS,
        properties=PROPERTIES,
        flags=mapping_of(TEXT, optional(TERM)),
        dynamic=sequence_of(FUNCTOR),
        replaced=sequence_of(FUNCTOR),
        files=sequence_of(PATH),
        states=_POSITIONS,
        timers=sequence_of(tuple_of(TERM, TERM)),
    ),
)


def save_deployments(
    deployments: Dict[str, Deployment],
    logic: PrologSystem,
    knowledge: KnowledgeBase,
    numbered_rules: List[EventRule],
) -> Dict[str, StoredDeployment]:
    """Return the deployments as data for a saved state.

    Args:
        deployments: the deployments by folder.
        logic: contains the clauses.
        knowledge: contains memories, subscriptions and states.
        numbered_rules: the rules of the saved state; a position in this list identifies a rule.
    """
    rules = {id(rule): position for position, rule in enumerate(numbered_rules)}
    predicates = program_predicates(logic)
    clauses = {
        id(clause): position
        for predicate in predicates
        for position, clause in enumerate(predicate.active_clauses())
    }
    memories = {id(memory): position for position, memory in enumerate(knowledge.memories)}
    subscriptions = {
        id(subscription): position
        for position, (_, subscription) in enumerate(knowledge.subscriptions.items())
    }
    states = {id(state): position for position, state in enumerate(knowledge.states)}
    return {
        folder: StoredDeployment(
            rules=[rules[id(rule)] for rule in deployment.rules if id(rule) in rules],
            clauses=[
                (predicate.functor, [clauses[id(clause)] for clause in clause_list if id(clause) in clauses])
                for predicate, clause_list in deployment.clauses.items()
            ],
            # A retracted clause has no position in its predicate. It is saved in full, because a reload needs it to
            # omit the same clauses, see `ReloadTransaction._remove_retracted`.
            retracted=[
                (
                    predicate.functor,
                    [
                        StoredClause(clause.head, clause.body, clause.place)
                        for clause in clause_list
                        if id(clause) not in clauses
                    ],
                )
                for predicate, clause_list in deployment.clauses.items()
            ],
            memories=[
                memories[id(memory)] for memory in deployment.memories.values() if id(memory) in memories
            ],
            subscriptions=[
                subscriptions[id(subscription)]
                for subscription in deployment.subscriptions.values()
                if id(subscription) in subscriptions
            ],
            properties=[item for items in deployment.properties.values() for item in items],
            flags=deployment.flags,
            dynamic=[predicate.functor for predicate in deployment.dynamic],
            replaced=list(deployment.replaced),
            files=sorted(map(str, deployment.files)),
            states=[states[id(state)] for state in deployment.states.values() if id(state) in states],
            timers=[(timer.event, timer.schedule.term) for timer in deployment.timers.values()],
        )
        for folder, deployment in deployments.items()
    }


def restore_deployments(
    saved_state: Dict[str, StoredDeployment],
    logic: PrologSystem,
    knowledge: KnowledgeBase,
    timers: Timers,
    numbered_rules: List[EventRule],
) -> Dict[str, Deployment]:
    """Return the deployments from a saved state.

    One-shot timers that have fired since are omitted.
    """
    # The lists have the same order as when the state was saved, because items were restored in that order.
    memories = list(knowledge.memories.instances.items())
    subscriptions = knowledge.subscriptions.items()
    states = list(knowledge.states.all_by_key().items())
    deployments = {}
    for folder, saved in saved_state.items():
        properties: Dict[Hashable, List[Property]] = {}
        for item in saved.properties:
            properties.setdefault(term_key(item.label), []).append(item)
        folder_timers = [timers.find(*key) for key in saved.timers]
        deployments[folder] = Deployment(
            rules=[numbered_rules[position] for position in saved.rules],
            clauses=_restore_clauses(logic, saved),
            memories=dict(memories[position] for position in saved.memories),
            subscriptions=dict(subscriptions[position] for position in saved.subscriptions),
            properties=properties,
            flags=saved.flags,
            dynamic={_find_predicate(logic, key) for key in saved.dynamic},
            replaced=set(saved.replaced),
            files=set(map(Path, saved.files)),
            timers={timer.key: timer for timer in folder_timers if timer is not None},
            states=dict(states[position] for position in saved.states),
        )
    return deployments


def _find_predicate(logic: PrologSystem, key: Functor) -> Predicate:
    predicate = logic.database.predicate(key)
    return predicate.hidden_predicate or predicate


def _restore_clauses(logic: PrologSystem, saved: StoredDeployment) -> Dict[Predicate, List[Clause]]:
    """Return a deployment's clauses by predicate: existing clauses first, then retracted ones."""
    clauses: Dict[Predicate, List[Clause]] = {}
    for predicate_functor, positions in saved.clauses:
        predicate = _find_predicate(logic, predicate_functor)
        live_clauses = list(predicate.active_clauses())
        clauses[predicate] = [live_clauses[position] for position in positions]
    for predicate_functor, retracted_clauses in saved.retracted:
        predicate = _find_predicate(logic, predicate_functor)
        for head, body, place in retracted_clauses:
            clause = Clause(predicate, head, body, place)
            # Marked as retracted before any goal can call it.
            clause.retracted_at = 0
            clauses.setdefault(predicate, []).append(clause)
    return clauses
