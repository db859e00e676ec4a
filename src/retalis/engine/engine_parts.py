"""Parts of an engine, in the order of their construction."""

import os
from functools import partial
from typing import Callable, List, Optional

from ..events.clock.clock import Clock
from ..events.dispatch.dispatcher import Dispatcher
from ..events.knowledge.knowledge_base import OWN_EVENTS, KnowledgeBase
from ..events.language.rule_labels import WATERMARK_DELAY
from ..events.program.event_file_loader import EventFileLoader
from ..events.program.event_language_predicates import define_predicates
from ..events.rules.event_input_predicates import define_new_event
from ..events.rules.language_flags import FLAGS, MAX_WATERMARK_DELAY, Flags
from ..events.rules.rule_base import RuleBase
from ..foundation.errors import UsageError
from ..messages.message_slots import SlotNames
from ..messages.type_registry import Definitions
from ..prolog.files.source_files import SourceFiles
from ..prolog.machine.resource_limits import MEGABYTE, NO_LIMITS, Budget
from ..prolog.swi.use_swi import define_use_swi
from ..prolog.syntax.operators import Operators
from ..prolog.system.foreign_functions import define_use_foreign
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Term
from .engine_settings import CHANGEABLE_SETTINGS, Settings
from .engine_snapshot import EngineSnapshot, ForeignSources, RunState
from .engine_status import StatusReader
from .event_input import EventInput, InputTopics, TextInput
from .loaded_items import LoadedProgram
from .program_loader import ProgramLoader
from .ros_param_predicate import RosParameters
from .runtime.problem_reports import Reports
from .runtime.serial_executor import EngineRecovery, SerialExecutor
from .runtime.watchdog import report_exceeded_limits, start_watchdog
from .service_calls import ServiceCalls


class UserCallbacks:
    """Calls of callbacks of the user; errors in them are reported.

    Args:
        executor: names the running callback in the error of a thread that waits for it.
        budget: ends the event after an exception that is no error.
        reports: receives the errors.

    Attributes:
        on_output: called with term, topic and subscription id of each output.
    """

    def __init__(self, executor: SerialExecutor, budget: Budget, reports: Reports):
        self._executor = executor
        self._budget = budget
        self._reports = reports
        self.on_output: List[Callable[[Term, str, Term], object]] = []

    def call(self, name: str, callback: Callable[..., object], *arguments: object) -> None:
        """Call a callback."""
        outer_callback = self._executor.begin_callback(name)
        try:
            callback(*arguments)
        except Exception as error:
            # An error in a callback must not prevent the remaining consequences of the event.
            self._reports.error(error)
        except BaseException as exception:
            # The event ends at a safe point: an exception that passed here would leave it half processed.
            self._budget.end_entry(exception)
        self._executor.end_callback(outer_callback)

    def pass_output(self, term: Term, topic: str, name: Term) -> None:
        """Pass an output to the callbacks."""
        for callback in self.on_output:
            self.call("a callback of on_output", callback, term, topic, name)


class GoalCalls:
    """Calls of goals outside of events."""

    def __init__(self, logic: PrologSystem, dispatcher: Dispatcher):
        self._logic = logic
        self._dispatcher = dispatcher

    def call_once(self, goal: Term) -> bool:
        """Call a goal once.

        The trail is cleared afterwards if no other goal or event is active, because nothing will undo these bindings.
        """
        machine = self._logic.machine
        # Inside another goal or event the trail still belongs to an outer choice point and must stay.
        is_outermost = not machine.trail and not machine.choices and self._dispatcher.current is None
        try:
            return self._logic.once(goal)
        finally:
            if is_outermost:
                machine.trail.clear()

    def call_restoring_context(self, goal: Term) -> bool:
        """Call a goal once; if it raises, the context of the current event is restored."""
        return self._dispatcher.run_restoring_context(lambda: self.call_once(goal))


class EngineParts:
    """Parts of an engine. Arguments are those of `Engine`.

    The constructor reads from top to bottom: each part is created from parts above it. Where a part reports to a
    later one, the later one adds a callback. The executor comes first, because the limits of goals are those of its
    units of work; what it restores after an error is added when it exists.

    Attributes:
        slots: slots of messages, and the types of event names.
        goals: calls goals outside of events.
        program: predicates, rules, knowledge and their loader.
    """

    def __init__(
        self, clock: Clock, settings: Settings, reports: Reports, definitions: Optional[Definitions]
    ):
        self.clock, self.settings, self.reports = clock, settings, reports
        self.executor = executor = SerialExecutor(
            settings.queue, partial(_report_drop, reports), reports.error, callback_timeout=settings.patience
        )
        files = SourceFiles()
        files.sandbox.allow(settings.folders, settings.write_folders, settings.max_file_megabytes * MEGABYTE)
        self.slots = slots = SlotNames(definitions, settings.strings)
        self.logic = logic = PrologSystem(
            Operators.prolog(slots),
            limits=settings.limits,
            executor=executor,
            now=clock.now,
            files=files,
            # Python modules can read the environment anyway, so goals may read it, too.
            environment=os.environ if settings.allow_foreign else None,
            allow_flags=settings.allow_flags,
            counts_uses=settings.counts_uses,
        )
        self.callbacks = callbacks = UserCallbacks(executor, logic.machine.budget, reports)
        self.dispatcher = dispatcher = Dispatcher(logic, max_depth=settings.max_depth)
        executor.set_recovery(EngineRecovery(logic, dispatcher))
        self.rules = rules = RuleBase(
            logic,
            dispatcher,
            clock,
            files,
            on_error=reports.error,
            on_warning=reports.warning,
            is_external_event=lambda key: key in OWN_EVENTS or key.name in slots.events,
        )
        file_loader = EventFileLoader(rules)
        define_predicates(rules, file_loader)
        self.knowledge = knowledge = KnowledgeBase(
            logic,
            dispatcher,
            clock,
            callbacks.pass_output,
            reports.warning,
            rules,
            file_loader.warn_unknown_calls,
            buffer=settings.transform_buffer(settings.tf_cache),
        )
        rules.flags.on_numeric_change("max_gap", knowledge.gaps.set_limit)
        _set_default_flags(rules.flags, settings, Settings())
        report_exceeded_limits(logic.machine.budget, reports)
        self.watchdog = start_watchdog(executor, logic, dispatcher, reports, settings.watchdog)
        self.goals = goals = GoalCalls(logic, dispatcher)
        self.event_input = event_input = EventInput(
            logic, dispatcher, clock, rules, knowledge, executor.report_isolated_error
        )
        self.text_input = TextInput(
            logic.operators,
            event_input.dispatch_event,
            goals.call_restoring_context if settings.allow_goals else None,
            reports,
            rules.declared_events,
        )
        self.input_topics = InputTopics(logic, slots, reports)
        self.ros_parameters = RosParameters(logic, slots, reports)
        self.service_calls = ServiceCalls(
            logic,
            slots,
            executor,
            lambda event: event_input.dispatch_event(event, None, None),
            callbacks.call,
            reports,
        )
        self.program = program = LoadedProgram(logic, rules, knowledge, file_loader)
        self.loader = ProgramLoader(
            program,
            executor,
            dispatcher,
            settings.limit_start,
            goals.call_once,
            self.input_topics.declare_topics,
            slots.awaiting,
        )
        self.status_reader = StatusReader(
            program, executor, event_input, self.service_calls, reports, self.watchdog, settings.queue
        )
        self._run_state = RunState(
            clock,
            rules.network.watermarks,
            event_input,
            dispatcher,
            executor,
            knowledge.subscriptions,
            self.service_calls,
        )
        self._foreign_sources = ForeignSources(
            logic, files, executor, settings.allow_foreign, settings.allow_swi, reports.warning
        )
        define_new_event(logic, dispatcher)
        define_use_foreign(logic, executor, files, settings.allow_foreign)
        define_use_swi(logic, files, settings.allow_swi, reports.warning)

    def check_settings(self, settings: Settings) -> None:
        """Raise a `UsageError` if settings differ that are fixed; see `Engine.change_settings`."""
        for name in Settings._fields:
            if name not in CHANGEABLE_SETTINGS and getattr(settings, name) != getattr(self.settings, name):
                raise UsageError(f"change_settings: {name} is fixed: pass it to the constructor of Engine")
        if settings.limits[:3] != NO_LIMITS[:3] and not self.logic.machine.budget.meters_patterns:
            raise UsageError("change_settings: the engine was created without limits: create it with limits")

    def change_settings(self, settings: Settings) -> None:
        """Replace the settings that `Engine.change_settings` names; called in the engine's turn."""
        before, self.settings = self.settings, settings
        self.logic.limits = settings.limits
        self.watchdog.set_warning_time(settings.watchdog)
        _set_default_flags(self.rules.flags, settings, before)

    def create_snapshot(self) -> EngineSnapshot:
        """Return a reader and restorer of the state."""
        return EngineSnapshot(
            self.program,
            self._run_state,
            self.input_topics,
            self.slots,
            self.loader.deployments,
            self._foreign_sources,
        )


def _set_default_flags(flags: Flags, settings: Settings, before: Settings) -> None:
    """Set the defaults of the flags whose settings have changed."""
    for name in ("max_gap", WATERMARK_DELAY, MAX_WATERMARK_DELAY):
        value = getattr(settings, name)
        if value != getattr(before, name):
            flags.set_default(name, FLAGS[name].default if value is None else value)


def _report_drop(reports: Reports, dropped: int) -> None:
    reports.warning(f"events come in faster than they can be processed: {dropped} dropped so far", "dropped")
