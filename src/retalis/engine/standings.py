"""What each folder of a program has made, as data: by places among what there is."""

from pathlib import Path
from typing import Any, Dict, Hashable, List

from ..events.knowledge import Knowledge
from ..events.language import Property
from ..events.network import Rule
from ..events.rules import Timers
from ..prolog.database import Clause, Predicate
from ..prolog.logic import Logic, program_predicates
from ..prolog.terms import Functor, term_key
from .standing import Standing


def keep_standings(
    programs: Dict[str, Standing], logic: Logic, knowledge: Knowledge, named: List[Rule]
) -> Dict[str, Any]:
    """Return for each folder what it has made of what is there."""
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
    kept: Dict[str, Any], logic: Logic, knowledge: Knowledge, timers: Timers, named: List[Rule]
) -> Dict[str, Standing]:
    """Return what the folders have made, in an engine that has taken up a state.

    Timers that have rung for the last time since then are there no more.
    """
    memories = list(knowledge.memories.instances.items())
    subscriptions = knowledge.subscriptions.items()
    states = list(knowledge.states.standing().items())
    found = {}
    for folder, made in kept.items():
        properties: Dict[Hashable, List[Property]] = {}
        for one in made["properties"]:
            properties.setdefault(term_key(one.label), []).append(one)
        found[folder] = Standing(
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


def _predicate(logic: Logic, functor: Functor) -> Predicate:
    found = logic.database.predicate(functor)
    return found.tabled or found


def _clauses(logic: Logic, made: Dict[str, Any]) -> Dict[Predicate, List[Clause]]:
    """Return the clauses that a folder has made: those that are there, then those that were retracted since."""
    clauses: Dict[Predicate, List[Clause]] = {}
    for functor, places in made["clauses"]:
        predicate = _predicate(logic, functor)
        live = list(predicate.live())
        clauses[predicate] = [live[at] for at in places]
    for functor, gone in made["retracted"]:
        predicate = _predicate(logic, functor)
        for head, body, place in gone:
            clause = Clause(predicate, head, body, place)
            clause.died = 0
            clauses.setdefault(predicate, []).append(clause)
    return clauses
