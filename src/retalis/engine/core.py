"""What stands behind an engine: its parts, put together, and what they call."""

import os
from contextlib import closing
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple, Union

from ..events.dispatch import Dispatcher
from ..events.knowledge import OWN_EVENTS, Knowledge
from ..events.rules import Rules, define_new_event
from ..foundation import UsageError
from ..messages import Definitions, SlotNames
from ..prolog.foreign import define_use_foreign
from ..prolog.logic import Logic
from ..prolog.machine import MEGABYTE
from ..prolog.swi import define_use_swi
from ..prolog.syntax import ReadFlags, read_term
from ..prolog.terms import Term, Var, copy
from .callbacks import OnOutput
from .inputtopics import InputTopics
from .intake import Intake
from .looking import Seen, StatusReader
from .ownfiles import OwnFiles
from .runtime import (
    Clock,
    EngineRecovery,
    Reports,
    Runner,
    StreamClock,
    Watchdog,
    count_records_of,
    watch,
)
from .settings import Settings
from .standing import Standing
from .textinput import TextInput

READ = ReadFlags()
MADE = ReadFlags(made=True)
"""How a text is read that is a goal or pattern, and one that is an event."""


class EngineParts(NamedTuple):
    """What an engine is made of."""

    logic: Logic
    dispatcher: Dispatcher
    rules: Rules
    knowledge: Knowledge
    reports: Reports
    runner: Runner
    watchdog: Watchdog
    own_files: OwnFiles
    slots: SlotNames
    programs: Dict[str, Standing]
    input_topics: InputTopics
    intake: Intake


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
        self._logic = Logic()
        self._slots = self._logic.operators.slots = SlotNames(definitions)
        self._budget = budget = self._logic.machine.budget
        self._logic.limits = settings.limits
        self._logic.allow_flags = settings.allow_flags
        self._logic.now = self.clock.now
        self._dispatcher = Dispatcher(self._logic, max_depth=settings.max_depth)
        self._reports = reports = Reports() if reports is None else reports
        self._rules = Rules(self._logic, self._dispatcher, self.clock)
        self._rules.on_error = reports.error
        self._rules.on_warning = reports.warning
        declared = self._rules.declared
        self._files = self._rules.files
        self._files.door.allow(settings.folders, settings.write_folders)
        self._files.door.most = settings.max_file_megabytes * MEGABYTE
        self._knowledge = Knowledge(
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
        self._runner = Runner(settings.queue, self._report_drop, reports.error, recovery, settings.patience)
        budget.count_for(self._runner)
        self._watchdog = watch(self._runner, self._logic, self._dispatcher, reports, settings.watchdog)
        call = self._call_undisturbed if settings.allow_goals else None
        self._intake = Intake(self._logic, self._dispatcher, self.clock, followed, self._start_anew)
        self._take = self._intake.take  # bound once: one step less for each event
        self._message = self._intake.take_message
        self._text_input = TextInput(self._logic.operators, self._take, call, reports, declared)
        self._outputs: List[OnOutput] = []
        self._observed = False
        self._foreign: List[Tuple[object, ...]] = []
        self._programs: Dict[str, Standing] = {}
        """What the folder of a program has made, by its real path."""
        self._own_files = OwnFiles(
            self._logic, self._rules, self._runner, self._dispatcher, settings.limit_start, self._once
        )
        self._status = StatusReader(
            Seen(
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
