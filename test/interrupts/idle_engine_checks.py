"""What holds of an engine that does nothing, whatever was interrupted before."""

from threading import Thread

from retalis.events.rules.timer_service import TimerAlarm
from retalis.foundation.cancellation import CURRENT_CHECK


def faults(engine):
    """Return what is wrong with an idle engine, as texts."""
    found = []

    def check(holds, text):
        if not holds:
            found.append(text)

    machine, dispatcher, executor = (
        engine.logic.machine,
        engine.dispatcher,
        engine.executor,
    )
    budget = machine.budget
    check(not machine.choices, f"{len(machine.choices)} choice points are left")
    check(not machine.trail, f"{len(machine.trail)} variables are bound")
    check(machine.idle_lengths == (0, 0), "the idle state is another")
    check(not budget.running, "the budget runs")
    check(not budget.alarms and not budget.ceilings, "a limit of a call is left")
    check(
        not budget.has_use and not budget.needs_check and budget.goal is None,
        "the budget of an entry is left",
    )
    check(CURRENT_CHECK.check is None, "somebody is asked about long work")
    check(dispatcher.current is None and dispatcher.cause is None, "an event is being served")
    check(executor.thread is None and executor.running_callback is None, "the executor is at work")
    check(not len(executor) and not executor.callers, "something waits to be done")
    check(engine.rules.files.state()[1:] == (0, False), "a file is being loaded")
    check(engine.logic.new_goals is None, "goals are being prepared")
    check(not engine.rules.loader.is_loading, "a load is under way")
    found += _of_memories(engine.knowledge)
    found += _of_states(engine.knowledge)
    found += _of_timers(engine.rules.timers, engine.clock)
    for rule in engine.rules.rules:
        found += _of_rule(rule)
    found += _of_predicates(engine.logic)
    check(
        others_are_served(executor), "the lock is not given back"
    )  # the last: who comes in may mend the rest
    return found


def others_are_served(executor):
    """Tell whether the work of another thread is done at once."""
    done = []
    thread = Thread(target=executor.post, args=(done.append, 1))
    thread.start()
    thread.join()
    return bool(done)


def _of_memories(knowledge):
    waiting_at_all = {waiting[0] for waiting in knowledge.pending_queries}
    for instance in knowledge.memories:
        memory = instance.memory
        if memory.ends != [int(record[2]) for record in memory.records]:
            yield f"memory {instance.id}: ends and records differ"
        if instance not in instance.recorder.instances:
            yield f"memory {instance.id} records nothing"
        waiting = {order for group in instance.queries.values() for order in group}
        if not waiting <= waiting_at_all:
            yield f"memory {instance.id}: queries wait that are not there"
        if sorted(instance.queries) and min(instance.queries) < instance.next_instant:
            yield f"memory {instance.id} is due too late"
    for order, *_, missing in knowledge.pending_queries:
        instance, instant = missing[-1]
        if order not in instance.queries.get(instant, {}):
            yield "a query waits for nothing"


def _of_states(knowledge):
    for state in knowledge.states:
        there = set(state.open)
        ways = {key for group in state._open_by_shared_key.values() for key in group}  # noqa: SLF001
        if not there == ways == {one.key for one in state._open_by_order.values()}:  # noqa: SLF001
            yield f"{state.name}: what is open is not found in all ways"


def _of_timers(timers, clock):
    alarms = [
        alarm
        for _, _, alarm in clock.alarms
        if isinstance(alarm, TimerAlarm) and timers.is_valid_alarm(alarm)
    ]
    if [alarm.timer for alarm in alarms] != list(dict.fromkeys(alarm.timer for alarm in alarms)):
        yield "a timer has two alarms"
    if {alarm.timer for alarm in alarms} != set(timers):
        yield "a timer has no alarm"


def _of_rule(rule):
    waiting = []
    for node, _, _ in rule.nodes:
        for buffer in node.buffers():
            for key, last in buffer.newest.items():
                ring = buffer.matches_of_key(key)
                if [one.newer for one in ring] != [*ring[1:], ring[0]] or last is not ring[-1]:
                    yield f"{rule.name}: matches are linked wrong"
                if any(one.buffer is not buffer or one.key != key for one in ring):
                    yield f"{rule.name}: a match waits elsewhere"
                waiting += ring
    if rule.stored_match_count != len(waiting):
        yield f"{rule.name}: {len(waiting)} matches wait and {rule.stored_match_count} are counted"
    if not set(waiting) <= set(rule.arrivals):
        yield f"{rule.name}: a match can never be dropped"
    if not rule.listeners or not rule.is_connected:
        yield f"{rule.name} does not listen"


def _of_predicates(logic):
    for key, predicate in logic.database.predicates.items():
        if predicate.is_library_predicate:
            continue
        live = list(predicate.active_clauses())
        if len(predicate) != len(live):
            yield f"{key}: {len(live)} clauses live and {len(predicate)} are counted"
        if predicate.has_only_ground_facts and not all(clause.is_ground_fact for clause in live):
            yield f"{key} is no table of facts"
        if live and predicate.kind == "undefined":
            yield f"{key} has clauses and is not defined"
