"""Hot reload of a program's folder as a transaction.

A reload consists of these steps:

1. The folder is loaded into a trial engine that receives no events. Errors show there, and the running program is not
   affected.
2. While the running engine is idle, everything that the folder has created (its `Deployment`) is set aside: rules are
   deactivated, clauses removed, memories and subscriptions detached. Then the folder is loaded again.
3. Items that are the same as before continue with their state: a rule with an equal definition keeps its partial
   matches, a memory with an equal definition its records, a timer its next instant. Items that are gone are deleted.
4. If the second load fails all the same (a goal may depend on time or on files), the old deployment is restored.

Items that services or other goals have added since the first load do not belong to the deployment and stay unchanged.
"""

import os
from collections import Counter
from pathlib import Path
from threading import get_ident
from typing import Callable, Dict, Hashable, Iterable, List, Sequence

from ..events.clock.clock import Clock, StreamClock
from ..events.knowledge.memory import MemoryInstance
from ..events.network.event_rule import EventRule
from ..events.rules.program_timers import ProgramTimer
from ..foundation.displayed_text import format_count
from ..foundation.errors import Errors, ProgramErrors, RuleError, UsageError
from ..prolog.builtins.tabling import tables_of
from ..prolog.database.clause_index import Clause
from ..prolog.database.predicate import Predicate
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.term_traversal import term_key
from ..prolog.terms.types import Term, atom
from .engine_settings import Settings
from .loaded_items import (
    EMPTY_DEPLOYMENT,
    Clauses,
    Deployment,
    LoadedProgram,
    clause_key,
    current_deployment,
    pair_equal_rules,
)
from .program_loader import LOADING_WORK, ProgramLoader, resolve_path
from .runtime.problem_reports import Reports
from .runtime.serial_executor import UNNAMED_REQUEST, SerialExecutor

TimersByKey = Dict[Hashable, ProgramTimer]

_MAX_NAMED_CHANGES = 20
"""Maximum number of changes that are listed per kind of item."""


_ROLLBACK_WORK = atom("putting the old program back")
"""Names of work in warnings of the watchdog and of limits."""


def describe_changes(
    logic: PrologSystem,
    old: Deployment,
    new: Deployment,
    unchanged: Dict[EventRule, EventRule],
    clauses: Clauses,
) -> List[str]:
    """Return a description of the changes, in lines for people.

    Args:
        logic: converts terms to text.
        old: the deployment before the reload.
        new: the deployment after it.
        unchanged: the old rule for each new rule that replaces it unchanged.
        clauses: all clauses of the earlier loads, including those that have been retracted since.
    """
    return [
        *_describe_rules(old.rules, new.rules, unchanged),
        *_describe_memories(logic, old, new),
        *_describe_subscriptions(logic, old, new),
        *_describe_timers(logic, old, new),
        *_describe_states(old, new),
        *_describe_predicates(clauses, new.clauses),
    ]


def _describe_rules(
    old: Sequence[EventRule], new: Sequence[EventRule], unchanged: Dict[EventRule, EventRule]
) -> List[str]:
    unchanged_rules = set(unchanged.values())
    removed = [
        f"rule {rule.title}{_format_lost_matches(rule)}" for rule in old if rule not in unchanged_rules
    ]
    added = [f"rule {rule.title}" for rule in new if rule not in unchanged]
    match_count = sum(rule.match_count for rule in unchanged_rules)
    with_matches = f", with {_format_match_count(match_count)}" if match_count else ""
    return _format_section("rules", added, removed, [], f"{len(unchanged_rules)} kept{with_matches}")


def _format_lost_matches(rule: EventRule) -> str:
    return f", with {_format_match_count(rule.match_count)}" if rule.match_count else ""


def _format_match_count(number: int) -> str:
    return format_count(number, "partial match", "partial matches")


def _describe_memories(logic: PrologSystem, old: Deployment, new: Deployment) -> List[str]:
    unchanged, changed, added = [], [], []
    for key, instance in new.memories.items():
        before = old.memories.get(key)
        if before is instance:
            unchanged.append(instance)
        elif before is not None:
            changed.append(f"memory {logic.brief(instance.id)}: it is defined otherwise, and begins empty")
        else:
            added.append(f"memory {logic.brief(instance.id)}")
    removed = [
        f"memory {logic.brief(instance.id)}"
        for key, instance in old.memories.items()
        if key not in new.memories
    ]
    records = sum(len(instance.memory) for instance in unchanged)
    return _format_section(
        "memories", added, removed, changed, f"{len(unchanged)} kept, with {format_count(records, 'record')}"
    )


def _describe_subscriptions(logic: PrologSystem, old: Deployment, new: Deployment) -> List[str]:
    unchanged_count, changed, added = 0, [], []
    for key, subscription in new.subscriptions.items():
        before = old.subscriptions.get(key)
        name = f"subscription {logic.brief(subscription.id)} of topic {key[0]}"
        if before is None:
            added.append(name)
        elif before.key == subscription.key:
            unchanged_count += 1
        else:
            changed.append(name)
    removed = [
        f"subscription {logic.brief(subscription.id)} of topic {key[0]}"
        for key, subscription in old.subscriptions.items()
        if key not in new.subscriptions
    ]
    return _format_section("subscriptions", added, removed, changed, f"{unchanged_count} kept")


def _describe_timers(logic: PrologSystem, old: Deployment, new: Deployment) -> List[str]:
    if not (old.timers or new.timers):
        return []

    def describe_missing(timers: TimersByKey, excluded: TimersByKey) -> List[str]:
        return [
            f"timer {logic.brief(timer.event)}, {logic.brief(timer.schedule.term)}"
            for key, timer in timers.items()
            if key not in excluded
        ]

    unchanged_count = sum(key in old.timers for key in new.timers)
    return _format_section(
        "timers",
        describe_missing(new.timers, old.timers),
        describe_missing(old.timers, new.timers),
        [],
        f"{unchanged_count} kept",
    )


def _describe_states(old: Deployment, new: Deployment) -> List[str]:
    if not (old.states or new.states):
        return []
    unchanged = [state for key, state in new.states.items() if old.states.get(key) is state]
    changed = [state for key, state in new.states.items() if key in old.states and state not in unchanged]
    added = [state.name for key, state in new.states.items() if key not in old.states]
    removed = [state.name for key, state in old.states.items() if key not in new.states]
    open_count = sum(len(state.open) for state in unchanged)
    changed_texts = [f"{state.name}: it is declared otherwise, and nothing holds" for state in changed]
    return _format_section(
        "states", added, removed, changed_texts, f"{len(unchanged)} kept, {open_count} open"
    )


def _describe_predicates(old: Clauses, new: Clauses) -> List[str]:
    old_keys = {
        predicate: [clause_key(clause) for clause in clauses] for predicate, clauses in old.items() if clauses
    }
    new_keys: Dict[Hashable, List[Hashable]] = {
        predicate: [clause_key(clause) for clause in clauses] for predicate, clauses in new.items() if clauses
    }
    added = [
        f"predicate {predicate.functor}"
        for predicate in new
        if predicate in new_keys and predicate not in old_keys
    ]
    removed = [f"predicate {predicate.functor}" for predicate in old_keys if predicate not in new_keys]
    changed = [
        f"predicate {predicate.functor}"
        for predicate in old_keys
        if predicate in new_keys and new_keys[predicate] != old_keys[predicate]
    ]
    unchanged_count = sum(new_keys.get(predicate) == keys for predicate, keys in old_keys.items())
    return _format_section("predicates", added, removed, changed, f"{unchanged_count} kept")


def _format_section(
    section: str, added: List[str], removed: List[str], changed: List[str], unchanged_text: str
) -> List[str]:
    """Return a line with counts, and a line for each item that is new, changed or gone."""
    changed_count = f"{len(changed)} changed, " if changed else ""
    return [
        f"{section}: {len(added)} new, {changed_count}{len(removed)} gone, {unchanged_text}",
        *_format_changes("new", added),
        *_format_changes("changed", changed),
        *_format_changes("gone", removed),
    ]


def _format_changes(change: str, names: Sequence[str]) -> Iterable[str]:
    for name in names[:_MAX_NAMED_CHANGES]:
        yield f"  {change}: {name}"
    if len(names) > _MAX_NAMED_CHANGES:
        yield f"  {change}: {len(names) - _MAX_NAMED_CHANGES} more"


class NullReports(Reports):
    """Reports that discard everything: the same problems are reported again by the load into the running engine."""

    def _log(self, level: int, kind: object, text: str, max_texts: int = 1, first_only: bool = False) -> None:
        """Discard a message."""


def create_fixed_clock(instant: int) -> Clock:
    """Return a clock that stays at an instant until it is moved."""
    clock = StreamClock()
    clock.move_to(instant)
    return clock


def create_trial_settings(settings: Settings) -> Settings:
    """Return the settings for a trial engine."""
    return settings._replace(limit_start=True, watchdog=None)


def reload_folder(
    loader: ProgramLoader, executor: SerialExecutor, folder: Path, create_trial: Callable[[], ProgramLoader]
) -> List[str]:
    """Load a program's folder again; see `Engine.reload`."""
    program, deployments, key = loader.program, loader.deployments, resolve_path(folder)
    # The executor would run the reload inside the goal that requests it, whose own clauses would be removed.
    if executor.thread == get_ident():
        raise UsageError("a goal or callback of an engine cannot reload its program")
    trial = create_trial()
    # An event file may need definitions of other files, so it is not loaded alone into a trial engine.
    if os.path.isfile(folder):
        trial_deployment = current_deployment(trial.program)
    else:
        trial_deployment = trial.load_alone(folder, program.rules.files.omitted)
        check_ids(
            trial_deployment,
            executor.call(lambda: current_deployment(program)),
            deployments.get(key, EMPTY_DEPLOYMENT),
            program.logic.brief,
        )

    def replace_deployment() -> List[str]:
        transaction = ReloadTransaction(program, deployments.get(key, EMPTY_DEPLOYMENT), trial_deployment)
        files = program.rules.files
        try:
            with files.reloading(files.omitted):
                return transaction.run(lambda: loader.load_files(folder))
        finally:
            deployments[key] = transaction.deployment

    return executor.call(
        lambda: program.rules.dispatcher.run_restoring_context(replace_deployment), (UNNAMED_REQUEST,)
    )


def check_ids(
    trial_deployment: Deployment,
    current_items: Deployment,
    old_deployment: Deployment,
    show: Callable[[Term], str],
) -> None:
    """Check that no service has added an item with an id of the new program.

    Args:
        trial_deployment: deployment of the folder in the trial engine.
        current_items: all items of the running engine.
        old_deployment: deployment of the folder in the running engine.
        show: returns the text of an id.

    Raises:
        ProgramErrors: all ids that are in use.
    """
    # An id that exists in the running engine but not in the deployment was added by a service. Loading the folder
    # would fail on it only after the old program has been set aside, so it is reported here.
    conflicts = Errors()
    for key, instance in trial_deployment.memories.items():
        if key in current_items.memories and key not in old_deployment.memories:
            conflicts.append(
                RuleError(
                    f"memory {show(instance.id)} of the program exists already: it was added by a service or a goal"
                )
            )
    for key, subscription in trial_deployment.subscriptions.items():
        if key in current_items.subscriptions and key not in old_deployment.subscriptions:
            name = show(subscription.id)
            title = f"subscription {name} of topic {key[0]}"
            conflicts.append(
                RuleError(f"{title} of the program exists already: it was added by a service or a goal")
            )
    if conflicts:
        raise ProgramErrors(conflicts)


class ReloadTransaction:
    """Replacement of a folder's old deployment by its new one.

    Args:
        program: program of the running engine, which must be idle during `run`.
        old_deployment: the old deployment, as recorded after the last load.
        trial_deployment: the deployment in the trial engine.
    """

    def __init__(self, program: LoadedProgram, old_deployment: Deployment, trial_deployment: Deployment):
        self._program = program
        self._previous_items = current_deployment(program)
        # Items of the deployment may have been deleted, replaced or retracted since it was recorded.
        self._old_deployment = self._select_remaining(old_deployment)
        self._recorded_deployment = old_deployment
        self._trial_deployment = trial_deployment
        self.deployment = old_deployment
        """Deployment of the folder at present."""

    def run(self, load: Callable[[], None]) -> List[str]:
        """Replace the deployment; return the changes, one per line.

        Raises:
            RetalisError: the reason of a failure; the old program has been restored.
        """
        budget = self._program.logic.machine.budget
        try:
            self._deactivate_old()
            # The program without the folder. The difference to it after the load is the new deployment.
            program_without_folder = current_deployment(self._program)
            budget.run_as_entry((LOADING_WORK,), load)
            # Answers of tabled predicates may depend on clauses that were replaced.
            tables_of(self._program.logic.machine).clear()
            self.deployment = current_deployment(self._program).added_since(program_without_folder)
            description = describe_changes(
                self._program.logic,
                self._old_deployment,
                self.deployment,
                self._pair_unchanged_rules(),
                self._recorded_deployment.clauses,
            )
            self._restore_unchanged(program_without_folder)
        except BaseException as error:
            # This includes interrupts: a partly loaded program must not receive events.
            self._undo_after(error)
            raise
        self._delete_unused()
        return description

    def _select_remaining(self, deployment: Deployment) -> Deployment:
        """Return the part of a deployment that has not been deleted or replaced since."""
        current_items = self._previous_items
        rules, memories, subscriptions = (
            set(current_items.rules),
            current_items.memories,
            current_items.subscriptions,
        )
        clauses: Clauses = {}
        for predicate, clause_list in deployment.clauses.items():
            live = set(current_items.clauses.get(predicate, ()))
            clauses[predicate] = [clause for clause in clause_list if clause in live]
        return deployment._replace(
            rules=[rule for rule in deployment.rules if rule in rules],
            clauses=clauses,
            memories={key: item for key, item in deployment.memories.items() if memories.get(key) is item},
            subscriptions={
                key: item for key, item in deployment.subscriptions.items() if subscriptions.get(key) is item
            },
            timers={
                key: item for key, item in deployment.timers.items() if current_items.timers.get(key) is item
            },
            states={
                key: item for key, item in deployment.states.items() if current_items.states.get(key) is item
            },
        )

    # ---- deactivation of the old deployment ----------------------------------------------------------

    def _deactivate_old(self) -> None:
        """Set the items of the old deployment aside."""
        # They are not deleted: the load reactivates those with an equal definition, with their state.
        rules, knowledge, old = self._program.rules, self._program.knowledge, self._old_deployment
        for rule in old.rules:
            rules.detach(rule)
        for predicate, clauses in old.clauses.items():
            self._remove_clauses(predicate, clauses)
        knowledge.memories.detach(old.memories.values())
        knowledge.subscriptions.detach(old.subscriptions)
        rules.timers.detach(old.timers)
        knowledge.states.detach(old.states)
        properties = {
            key: [item for item in items if item not in old.properties.get(key, ())]
            for key, items in rules.all_properties().items()
        }
        rules.restore_properties({key: items for key, items in properties.items() if items})
        rules.files.set_loaded(rules.files.loaded - old.files)
        # A flag is reset only if it still has the folder's value. Otherwise a goal or a service has changed it since.
        for name, value in old.flags.items():
            new_value = self._trial_deployment.flags[name]
            if new_value is not None and rules.flags.get(name) == value:
                rules.flags.set(name, new_value)

    def _remove_clauses(self, predicate: Predicate, clauses: Sequence[Clause]) -> None:
        """Remove clauses; reset the predicate if it has no others."""
        for clause in clauses:
            predicate.remove(clause)
        if len(predicate):
            return
        # The predicate starts again as if it had never been loaded: uncompiled, and not dynamic unless declared so.
        predicate.compile_after = self._program.logic.database.compile_after
        if predicate in self._old_deployment.dynamic:
            predicate.dynamic = False
        key = predicate.functor
        library = self._program.logic.database.library.shadowed_predicates.get(key)
        if key in self._old_deployment.replaced and library is not None:
            # The library predicate that the folder had redefined becomes visible again.
            self._program.logic.database.restore_library(library)
        elif not predicate.dynamic:
            predicate.kind = "undefined"

    # ---- reactivation of unchanged items -------------------------------------------------------------

    def _pair_unchanged_rules(self) -> Dict[EventRule, EventRule]:
        """Return the old rule for each new rule that is equal to it.

        If the folder redefines other library predicates than before, no rule continues, because compiled goals of the
        old rules call the previous predicates.
        """
        if self.deployment.replaced != self._old_deployment.replaced:
            return {}
        return pair_equal_rules(self._old_deployment.rules, self.deployment.rules, _make_rule_key)

    def _restore_unchanged(self, program_without_folder: Deployment) -> None:
        """Replace new rules by the equal old ones, and retract the clauses that had been retracted."""
        rules = self._program.rules
        old_rules = self._pair_unchanged_rules()
        own_rules = []
        for rule in self.deployment.rules:
            old_rule = old_rules.get(rule)
            if old_rule is not None:
                # Partial matches refer to the old rule object, so this object is kept and gets the new position.
                old_rule.place = rule.place
            own_rules.append(old_rule or rule)
        new_rules = set(self.deployment.rules)
        other_rules = [rule for rule in rules.rules if rule not in new_rules]
        unchanged_rules = set(own_rules)
        rules.activate_exactly(
            [*own_rules, *other_rules],
            [rule for rule in self._old_deployment.rules if rule not in unchanged_rules],
        )
        self.deployment = self.deployment._replace(rules=own_rules)
        for predicate, clauses in self.deployment.clauses.items():
            self._remove_retracted(predicate, clauses, program_without_folder.clauses.get(predicate, []))

    def _remove_retracted(
        self, predicate: Predicate, clauses: List[Clause], base_clauses: List[Clause]
    ) -> None:
        """Remove clauses of a dynamic predicate that the old program had loaded and retracted at run time.

        If the load itself has changed the clauses, they are left as the load has made them.
        """
        live = set(predicate.active_clauses())
        if not predicate.dynamic or not live.issuperset(base_clauses):
            return
        remaining = set(self._old_deployment.clauses.get(predicate, ()))
        loaded = self._recorded_deployment.clauses.get(predicate, ())
        # Clauses are compared by content and counted, because the load has created new clause objects.
        retracted = Counter(
            clause_key(loaded_clause) for loaded_clause in loaded if loaded_clause not in remaining
        )
        for clause in clauses:
            key = clause_key(clause)
            if retracted[key] > 0:
                retracted[key] -= 1
                predicate.remove(clause)

    def _delete_unused(self) -> None:
        """Delete the items that were set aside and not reactivated; emit the events for deleted memories."""
        knowledge = self._program.knowledge
        knowledge.subscriptions.discard_detached()
        self._program.rules.timers.discard_detached()
        knowledge.states.discard_detached()
        for instance in knowledge.memories.discard_detached():
            self._report_deleted(instance)

    def _report_deleted(self, instance: MemoryInstance) -> None:
        knowledge, machine = self._program.knowledge, self._program.logic.machine
        if knowledge.memories.find(instance.id) is None:
            self._program.rules.dispatcher.run_without_context(
                lambda: machine.run(knowledge.memories.report_deleted(instance, machine.done))
            )

    # ---- rollback ------------------------------------------------------------------------------------

    def _undo_after(self, error: BaseException) -> None:
        """Restore the old program after an error.

        Raises:
            UsageError: if restoring fails.
        """
        try:
            # The restoration has limits of its own: the failed load may have used up those of the request.
            self._program.logic.machine.budget.run_as_entry((_ROLLBACK_WORK,), self._undo)
        except Exception as undo_error:
            raise UsageError(
                f"the program does not load ({error}), "
                f"and the old one could not be restored ({undo_error}): restart it"
            ) from error

    def _undo(self) -> None:
        """Restore flags, rules, memories, subscriptions, timers, states and clauses."""
        rules, knowledge, before = self._program.rules, self._program.knowledge, self._previous_items
        for name, value in before.flags.items():
            if value is not None:
                rules.flags.set(name, value)
        rules.restore_properties(before.properties)
        rules.activate_exactly(before.rules)
        rules.files.set_loaded(before.files)
        knowledge.memories.restore_all(list(before.memories.values()))
        knowledge.subscriptions.restore_all(list(before.subscriptions.items()))
        rules.timers.restore_all(before.timers)
        knowledge.states.restore_all(before.states)
        self._undo_clauses()
        tables_of(self._program.logic.machine).clear()

    def _undo_clauses(self) -> None:
        """Restore the clauses of all predicates; removed clause objects cannot be added again, so they are copied."""
        database = self._program.logic.database
        for predicate, clauses in current_deployment(self._program).clauses.items():
            if predicate not in self._previous_items.clauses:
                self._remove_clauses(predicate, clauses)
        copies: Dict[Clause, Clause] = {}
        for predicate, clauses in self._previous_items.clauses.items():
            if list(predicate.active_clauses()) == clauses:
                continue
            # A removed clause is marked as dead for running goals (logical update view), and this cannot be undone.
            predicate.clear()
            database.restore_program(predicate)
            predicate.dynamic = predicate in self._previous_items.dynamic
            for clause in clauses:
                clause_copy = copies[clause] = Clause(predicate, clause.head, clause.body, clause.place)
                predicate.add(clause_copy)
        # The deployment must refer to the copies, or the next reload would not find its clauses.
        restored_clauses = {
            key: [copies.get(clause, clause) for clause in clause_list]
            for key, clause_list in self._recorded_deployment.clauses.items()
        }
        present_subscriptions = dict(self._program.knowledge.subscriptions.items())
        subscriptions = {key: present_subscriptions[key] for key in self._old_deployment.subscriptions}
        self.deployment = self._recorded_deployment._replace(
            clauses=restored_clauses, subscriptions=subscriptions
        )


def _make_rule_key(rule: EventRule) -> Hashable:
    return rule.definition.key, None if rule.label is None else term_key(rule.label)
