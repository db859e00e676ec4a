"""What users hand to an engine to be called.

What stands behind an engine: its parts, put together, and what they call.
"""

import os
from contextlib import closing
from typing import Callable, Dict, List, NamedTuple, Optional, Protocol, Tuple, Union

from ..events.dispatch.dispatcher import Dispatcher
from ..events.knowledge.knowledge_base import OWN_EVENTS, KnowledgeBase
from ..events.rules.event_predicates import define_new_event
from ..events.rules.rule_base import RuleBase
from ..foundation.errors import UsageError
from ..messages.field_names import SlotNames
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import MEGABYTE
from ..prolog.swi.use_swi import define_use_swi
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.system.foreign_functions import define_use_foreign
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import Term, Var
from .deployment import Deployment
from .engine_settings import Settings
from .engine_status import EngineView, StatusReader
from .event_input import EventInput, InputTopics, TextInput
from .program_loader import ProgramLoader
from .runtime.clock import Clock, StreamClock
from .runtime.gc_tuning import count_records_of
from .runtime.problem_reports import Reports
from .runtime.serial_executor import EngineRecovery, SerialExecutor
from .runtime.watchdog import Watchdog, watch


class OnOutput(Protocol):
    """What `Engine.on_output` takes: called with the term, the topic and the subscription's id of each output.

    >>> def tell(term: Term, topic: str, name: Term) -> None:
    ...     print(topic, engine.show(term), engine.show(name))
    >>> engine = Engine()
    >>> engine.on_output(tell)
    >>> engine.load(goals="subscribe(bark(Dog), [], Dog, dogs, first)")
    >>> engine.event("bark(rex)", 1)
    dogs rex first
    """

    def __call__(self, term: Term, topic: str, name: Term, /) -> object:
        """Take an output."""


class OnEvent(Protocol):
    """What `Engine.on_event` takes: called with the term, and start and end in nanoseconds, of each event.

    >>> def tell(term: Term, start: int, end: int) -> None:
    ...     print(engine.show(term), start, end)
    >>> engine = Engine()
    >>> engine.on_event(tell)
    >>> engine.load(rules="walk <- left seq right.")
    >>> engine.event("left", 1)
    left 1000000000 1000000000
    >>> engine.event("right", 2)
    right 2000000000 2000000000
    walk 1000000000 2000000000
    """

    def __call__(self, term: Term, start: int, end: int, /) -> object:
        """Take an event."""


READ = ReadFlags()
MADE = ReadFlags(made=True)
"""How a text is read that is a goal or pattern, and one that is an event."""


class EngineParts(NamedTuple):
    """What an engine is made of."""

    logic: PrologSystem
    dispatcher: Dispatcher
    rules: RuleBase
    knowledge: KnowledgeBase
    reports: Reports
    runner: SerialExecutor
    watchdog: Watchdog
    own_files: ProgramLoader
    slots: SlotNames
    programs: Dict[str, Deployment]
    input_topics: InputTopics
    intake: EventInput


class EngineCore:
    """An engine without what users call; see `Engine`."""

    def __init__(
        self,
        clock: Optional[Clock] = None,
        settings: Optional[Settings] = None,
        reports: Optional[Reports] = None,
        definitions: Optional[Definitions] = None,
    ):
        followed = StreamClock() if clock is None else None  # somebody's own clock is moved by its owner
        self.clock: Clock = clock or followed  # type: ignore[assignment]
        self.settings = settings = Settings() if settings is None else settings
        self._logic = PrologSystem()
        self._slots = self._logic.operators.slots = SlotNames(definitions)
        self._budget = budget = self._logic.machine.budget
        self._logic.limits = settings.limits
        self._logic.allow_flags = settings.allow_flags
        self._logic.now = self.clock.now
        self._dispatcher = Dispatcher(self._logic, max_depth=settings.max_depth)
        self._reports = reports = Reports() if reports is None else reports
        self._rules = RuleBase(self._logic, self._dispatcher, self.clock)
        self._rules.on_error = reports.error
        self._rules.on_warning = reports.warning
        declared = self._rules.declared
        self._files = self._rules.files
        self._files.door.allow(settings.folders, settings.write_folders)
        self._files.door.most = settings.max_file_megabytes * MEGABYTE
        self._knowledge = KnowledgeBase(
            self._logic, self._dispatcher, self.clock, self._deliver, reports.warning, self._rules
        )
        self._rules.on_reset = self._knowledge.reset
        self._rules.flags.followers["max_gap"] = self._knowledge.gaps.limit
        if settings.max_gap is not None:
            self._rules.flags.set_default("max_gap", settings.max_gap)
        self._knowledge.on_conditions = self._rules.note_conditions
        declared.others = lambda key: key in OWN_EVENTS or key.name in self._slots.events
        self._knowledge.on_pattern = declared.require
        recovery = EngineRecovery(self._logic, self._dispatcher, self._rules, self._knowledge)
        self._runner = SerialExecutor(
            settings.queue, self._report_drop, reports.error, recovery, settings.patience
        )
        budget.count_for(self._runner)
        self._watchdog = watch(self._runner, self._logic, self._dispatcher, reports, settings.watchdog)
        call = self._call_undisturbed if settings.allow_goals else None
        self._intake = EventInput(self._logic, self._dispatcher, self.clock, followed, self._start_anew)
        self._take = self._intake.take  # bound once: one step less for each event
        self._message = self._intake.take_message
        self._text_input = TextInput(self._logic.operators, self._take, call, reports, declared)
        self._outputs: List[OnOutput] = []
        self._observed = False
        self._foreign: List[Tuple[object, ...]] = []
        self._programs: Dict[str, Deployment] = {}
        """What the folder of a program has made, by its real path."""
        self._own_files = ProgramLoader(
            self._logic, self._rules, self._runner, self._dispatcher, settings.limit_start, self._once
        )
        self._status = StatusReader(
            EngineView(
                self._logic,
                self._dispatcher,
                self._rules,
                self._knowledge,
                self.clock,
                reports,
                self._runner,
                self._watchdog,
                lambda: self._intake.taken,
                settings.queue,
            )
        )
        count_records_of(self._status)
        define_new_event(self._logic, self._dispatcher)
        self._input_topics = InputTopics(self._logic, self._slots, reports)
        define_use_foreign(self._logic, self._runner, self._files, settings.allow_foreign)
        if settings.allow_foreign:  # Python may read it all the same
            self._logic.environment = os.environ
        define_use_swi(self._logic, self._files, settings.allow_swi, reports.warning)

    def _take_fitting(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        """Take an event that is no message of a topic.

        Raises:
            UsageError: where it does not fit its declaration.
        """
        declared = self._rules.declared
        wrong = declared.refusal(term) if declared.in_use else ""
        if wrong:
            raise UsageError(f"event refused: {wrong}")
        self._take(term, start, end)

    def _read(self, term: Union[str, Term], flags: ReadFlags = READ) -> Term:
        return read_term(term, self._logic.operators, "text", flags).term if isinstance(term, str) else term

    def _once(self, goal: Term) -> bool:
        """Call a goal once; where nothing else is under way nobody will undo its bindings: no trail of them stays."""
        machine = self._logic.machine
        outermost = not machine.trail and not machine.choices and self._dispatcher.current is None
        try:
            return self._logic.once(goal)
        finally:
            if outermost:
                machine.trail.clear()

    def _call_undisturbed(self, goal: Term) -> bool:
        return self._dispatcher.undisturbed(lambda: self._once(goal))

    def _start_anew(self) -> None:
        """Forget what waits and what is remembered: time went back."""
        self._knowledge.clear()
        self._rules.clear()

    def _deliver(self, term: Term, topic: str, name: Term) -> None:
        for callback in self._outputs:
            self._call_back("a callback of on_output", callback, term, topic, name)

    def _call_back(self, what: str, callback: Callable[..., object], *arguments: object) -> None:
        runner = self._runner
        outer = runner.callback
        runner.callback = (what,)
        try:
            callback(*arguments)
        except Exception as error:  # a subscriber's own fault must not cut off what follows of the event
            self._reports.error(error)
        runner.callback = outer

    def _report_drop(self, dropped: int) -> None:
        self._reports.warning(
            f"events come in faster than they can be processed: {dropped} dropped so far", "dropped"
        )

    def _solutions(self, term: Term, names: Dict[str, Var], most: Optional[int]) -> List[Dict[str, Term]]:
        found: List[Dict[str, Term]] = []
        with closing(self._logic.solutions(term)) as solutions:
            for _ in solutions:
                # A variable in two values stays one variable. The copies count for the goal.
                shared: Dict[Var, Term] = {}
                with self._logic.machine.budget.watching():
                    found.append({name: copy(value, shared) for name, value in names.items()})
                if most is not None and len(found) >= most:
                    break
        return found


def parts_of(engine: EngineCore) -> EngineParts:
    """Return what an engine is made of, for those rooms and tests that look inside; programs need none of it."""
    return EngineParts(
        engine._logic,  # noqa: SLF001
        engine._dispatcher,  # noqa: SLF001
        engine._rules,  # noqa: SLF001
        engine._knowledge,  # noqa: SLF001
        engine._reports,  # noqa: SLF001
        engine._runner,  # noqa: SLF001
        engine._watchdog,  # noqa: SLF001
        engine._own_files,  # noqa: SLF001
        engine._slots,  # noqa: SLF001
        engine._programs,  # noqa: SLF001
        engine._input_topics,  # noqa: SLF001
        engine._intake,  # noqa: SLF001
    )
