"""What has changed where a program was read again, as lines for people."""

from typing import Dict, Hashable, Iterable, List, Sequence

from ..events.network import Rule
from ..events.rules import ProgramTimer
from ..foundation import Place, counted
from ..prolog.logic import Logic
from .standing import Clauses, Standing, clause_key

Timed = Dict[Hashable, ProgramTimer]

_MOST = 20
"""How many of one kind are named."""


def changes(
    logic: Logic, old: Standing, new: Standing, kept: Dict[Rule, Rule], clauses: Clauses
) -> List[str]:
    """Return what has changed.

    Args:
        logic: shows names.
        old: what there was of the program.
        new: what there is of it.
        kept: for new rules the old ones that go on in their places.
        clauses: those that the program has had, which may have been retracted since.
    """
    return [
        *_rules(old.rules, new.rules, kept),
        *_memories(logic, old, new),
        *_subscriptions(logic, old, new),
        *_timers(logic, old, new),
        *_states(old, new),
        *_predicates(clauses, new.clauses),
    ]


def _rules(old: Sequence[Rule], new: Sequence[Rule], kept: Dict[Rule, Rule]) -> List[str]:
    staying = set(kept.values())
    gone = [f"{rule.name}{_lost(rule)}" for rule in old if rule not in staying]
    fresh = [f"{rule.name}{_at(rule.place)}" for rule in new if rule not in kept]
    waiting = sum(rule.held for rule in staying)
    with_matches = f", with {_matches(waiting)}" if waiting else ""
    return _told("rules", fresh, gone, [], f"{len(staying)} kept{with_matches}")


def _lost(rule: Rule) -> str:
    return f", with {_matches(rule.held)}" if rule.held else ""


def _matches(number: int) -> str:
    return counted(number, "partial match", "partial matches")


def _at(place: object) -> str:
    return f" ({place.source}:{place.line})" if isinstance(place, Place) else ""


def _memories(logic: Logic, old: Standing, new: Standing) -> List[str]:
    kept, changed, fresh = [], [], []
    for key, one in new.memories.items():
        before = old.memories.get(key)
        if before is one:
            kept.append(one)
        elif before is not None:
            changed.append(f"memory {logic.brief(one.id)}: it is defined otherwise, and begins empty")
        else:
            fresh.append(f"memory {logic.brief(one.id)}")
    gone = [f"memory {logic.brief(one.id)}" for key, one in old.memories.items() if key not in new.memories]
    records = sum(len(one.memory) for one in kept)
    return _told("memories", fresh, gone, changed, f"{len(kept)} kept, with {counted(records, 'record')}")


def _subscriptions(logic: Logic, old: Standing, new: Standing) -> List[str]:
    kept, changed, fresh = 0, [], []
    for key, one in new.subscriptions.items():
        before = old.subscriptions.get(key)
        name = f"subscription {logic.brief(one.id)} of topic {key[0]}"
        if before is None:
            fresh.append(name)
        elif before.key == one.key:
            kept += 1
        else:
            changed.append(name)
    gone = [
        f"subscription {logic.brief(one.id)} of topic {key[0]}"
        for key, one in old.subscriptions.items()
        if key not in new.subscriptions
    ]
    return _told("subscriptions", fresh, gone, changed, f"{kept} kept")


def _timers(logic: Logic, old: Standing, new: Standing) -> List[str]:
    if not (old.timers or new.timers):
        return []
    show = logic.brief

    def named(found: Timed, others: Timed) -> List[str]:
        return [
            f"timer {show(one.event)}, {show(one.schedule.term)}"
            for key, one in found.items()
            if key not in others
        ]

    kept = sum(key in old.timers for key in new.timers)
    return _told("timers", named(new.timers, old.timers), named(old.timers, new.timers), [], f"{kept} kept")


def _states(old: Standing, new: Standing) -> List[str]:
    if not (old.states or new.states):
        return []
    kept = [one for key, one in new.states.items() if old.states.get(key) is one]
    changed = [one for key, one in new.states.items() if key in old.states and one not in kept]
    fresh = [one.name for key, one in new.states.items() if key not in old.states]
    gone = [one.name for key, one in old.states.items() if key not in new.states]
    hold = sum(len(one.open) for one in kept)
    told = [f"{one.name}: it is declared otherwise, and nothing holds" for one in changed]
    return _told("states", fresh, gone, told, f"{len(kept)} kept, {hold} open")


def _predicates(old: Clauses, new: Clauses) -> List[str]:
    before = {one: [clause_key(clause) for clause in found] for one, found in old.items() if found}
    now: Dict[Hashable, List[Hashable]] = {
        one: [clause_key(clause) for clause in found] for one, found in new.items() if found
    }
    fresh = [f"predicate {one.functor}" for one in new if one in now and one not in before]
    gone = [f"predicate {one.functor}" for one in before if one not in now]
    changed = [f"predicate {one.functor}" for one in before if one in now and now[one] != before[one]]
    same = sum(now.get(one) == found for one, found in before.items())
    return _told("predicates", fresh, gone, changed, f"{same} kept")


def _told(what: str, fresh: List[str], gone: List[str], changed: List[str], kept: str) -> List[str]:
    """Return a line of numbers, and one for each thing that is not what it was."""
    other = f"{len(changed)} changed, " if changed else ""
    return [
        f"{what}: {len(fresh)} new, {other}{len(gone)} gone, {kept}",
        *_named("new", fresh),
        *_named("changed", changed),
        *_named("gone", gone),
    ]


def _named(how: str, names: Sequence[str]) -> Iterable[str]:
    for name in names[:_MOST]:
        yield f"  {how}: {name}"
    if len(names) > _MOST:
        yield f"  {how}: {len(names) - _MOST} more"
