"""The engine: a program, the events that it takes, and what its subscribers get."""

from contextlib import closing
from pathlib import Path
from typing import (
    Callable,
    Collection,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Tuple,
    TypeVar,
    Union,
)

from ..events.dispatch import Dispatcher, Stage
from ..events.knowledge import Knowledge
from ..events.program import (
    GOALS,
    MEGABYTE,
    read_text,
    unknown_memories,
    unread_rules,
    wrong_messages,
)
from ..events.rules import Rules, define_new_event
from ..foundation import RuleError
from ..messages import Definitions
from ..prolog.foreign import define_foreign, define_use_foreign
from ..prolog.logic import Logic
from ..prolog.machine import Frame
from ..prolog.syntax import Operators, read_term
from ..prolog.terms import Functor, Term, Var, WholeSeconds, copy, timestamps, variables
from .callbacks import OnEvent, OnOutput
from .intake import Intake
from .ownfiles import REQUEST, OwnFiles
from .runtime import Clock, EngineRecovery, Reports, Runner, StreamClock, Watchdog, watch
from .settings import Settings
from .textinput import TextInput

Instant = Union[int, Term]


Result = TypeVar("Result")


class EngineParts(NamedTuple):
    """What an engine is made of."""

    logic: Logic
    dispatcher: Dispatcher
    rules: Rules
    knowledge: Knowledge
    reports: Reports
    runner: Runner
    watchdog: Watchdog


class Engine:
    """A running program.

    Events go in (`event`, `post`), outputs come out (`on_output`), questions are answered (`query`). Calls may
    come from any thread: one at a time does the work. What goes wrong in a rule, goal or callback is logged (logger
    ``retalis``) with its place, and the rest goes on.

    A callback (`on_output`, `on_event`, a foreign predicate) may ask the engine itself, and `post` from any thread.
    It must not wait for another thread that asks: that one waits for the callback. Where it does so all the same,
    the other thread gets a `UsageError` when the one callback has taken ``settings.patience`` seconds.

    An interrupt (Ctrl-C) may come at any moment. The event or goal that is worked on is over then: what it has
    done stays done, what follows from that and has not been done is left out, no cleanup is. Everything else is as
    if nothing had been: no event that comes later is served in another way.

    >>> engine = Engine()
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", goals="subscribe(alarm(_), [], _, alarms, a)")
    >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
    >>> engine.event("smoke(kitchen)", 1, 1)
    >>> engine.event("heat(kitchen)", 2, 2)
    alarms alarm(kitchen)

    Args:
        clock: what time it is; by default a clock that follows the stamps of events and never goes back.
        settings: limits and sizes.
        reports: takes what goes wrong while events flow; by default it is logged.
    """

    def __init__(
        self,
        clock: Optional[Clock] = None,
        settings: Optional[Settings] = None,
        reports: Optional[Reports] = None,
    ):
        followed = StreamClock() if clock is None else None  # somebody's own clock is moved by its owner
        self.clock: Clock = clock or followed  # type: ignore[assignment]
        self.settings = settings = Settings() if settings is None else settings
        self._logic = Logic()
        self._budget = budget = self._logic.machine.budget
        self._logic.limits = settings.limits
        self._logic.now = self.clock.now
        self._dispatcher = Dispatcher(self._logic, max_depth=settings.max_depth)
        self._reports = reports = Reports() if reports is None else reports
        self._rules = Rules(self._logic, self._dispatcher, self.clock)
        self._rules.on_error = reports.error
        self._rules.on_warning = reports.warning
        self._files = self._rules.files
        self._files.door.allow(settings.folders, settings.write_folders)
        self._files.door.most = settings.max_file_megabytes * MEGABYTE
        self._knowledge = Knowledge(
            self._logic, self._dispatcher, self.clock.stamp, self._deliver, reports.warning
        )
        self._knowledge.on_conditions = self._rules.note_conditions
        recovery = EngineRecovery(self._logic, self._dispatcher, self._rules, self._knowledge)
        self._runner = Runner(settings.queue, self._report_drop, reports.error, recovery, settings.patience)
        budget.count_for(self._runner)
        self._watchdog = watch(self._runner, self._logic, self._dispatcher, reports, settings.watchdog)
        call = self._call_undisturbed if settings.allow_goals else None
        self._intake = Intake(self._logic, self._dispatcher, self.clock, followed, self._start_anew)
        self._take, self._message = (
            self._intake.take,
            self._intake.take_message,
        )  # one step less for each event
        self._text_input = TextInput(self._logic.operators, self._take, call, reports)
        self._outputs: List[OnOutput] = []
        self._own_files = OwnFiles(
            self._logic, self._rules, self._runner, self._dispatcher, settings.limit_start, self._once
        )
        define_new_event(self._logic, self._dispatcher)
        define_use_foreign(self._logic, self._runner, self._files, settings.allow_foreign)

    # ---- loading -------------------------------------------------------------------------------------

    def load(
        self, rules: str = "", goals: str = "", source: str = "text", folder: Optional[Path] = None
    ) -> None:
        """Load goals and then rules from texts.

        Args:
            rules: an event file's text.
            goals: a goal file's text.
            source: what errors call them.
            folder: the program's own, which its goals may read from then on, and where relative paths start;
                without one the texts name files from the working directory on, and later goals read nothing.

        Raises:
            ProgramErrors: all errors; goals before a failed one have been called, of wrong rules none is active.
        """
        if goals:
            self.call_goals(goals, f"goals of {source}" if source == "text" else source, folder)
        if rules:
            self.load_rules(rules, source, folder)

    def load_rules(self, text: str, source: str = "text", folder: Optional[Path] = None) -> None:
        """Load the text of an event file; see `load`.

        Raises:
            ProgramErrors: all errors; nothing of the text is active then.
        """
        self._own_files.load_rules(text, source, folder)

    def load_program(self, folder: Union[str, Path]) -> None:
        """Call the goals of ``goalPredicates.txt`` in a program's folder; they name the rule files.

        Raises:
            ProgramErrors: the goals that did not read, failed or raised; the others have been called.
            UsageError: where the file cannot be read.
        """
        path = Path(folder) / GOALS
        self.call_goals(read_text(path), str(path), path.parent)

    def call_goals(self, text: str, source: str, folder: Optional[Path] = None) -> None:
        """Call the goals of a goal file one after the other; see `load`.

        Raises:
            ProgramErrors: all that did not read, failed or raised; the others have been called.
        """
        self._own_files.call_goals(text, source, folder)

    def add_foreign(self, *sources: object) -> List[Functor]:
        """Define Python functions that have the decorator `foreign`, and those of modules, as predicates.

        Returns:
            The functors of the predicates.

        Raises:
            UsageError: for a function without the decorator, or a module in which none has it.
            PrologError: where a predicate of the system has that name.
        """
        return self._runner.call(lambda: define_foreign(self._logic, self._runner, *sources))

    # ---- events --------------------------------------------------------------------------------------

    def event(
        self, term: Union[str, Term], start: Optional[Instant] = None, end: Optional[Instant] = None
    ) -> None:
        """Take an event and return when all that follows from it is done.

        Args:
            term: the event, as a term or its text.
            start: when it began: a stamp term or a number of seconds; by default now, by the clock.
            end: when it ended; as ``start`` by default.

        Raises:
            UsageError: for a wrong stamp or an end before the start.
            SyntaxFault: for a text that is not a term.
        """
        first = None if start is None else timestamps.from_any(start)
        last = first if end is None else timestamps.from_any(end)
        self.event_at(self._read(term), first, last)

    def event_at(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        """Take an event whose interval is given as instants in nanoseconds; see `event`."""
        self._runner.call(lambda: self._take(term, start, end), (term,))

    def post(self, term: Term, instant: Optional[int] = None) -> None:
        """Queue a message and return without waiting for others.

        Args:
            term: the event, without variables.
            instant: when it happened, in nanoseconds; by default now, by the clock.
        """
        if instant is None:
            self._runner.post(self._message, term)
        else:
            instant = WholeSeconds(instant)  # the form in which the converter writes it
            self._runner.post(self._take, term, instant, instant, True)

    def post_text(self, text: str) -> None:
        """Queue an event as other nodes send it: ``event(E)``, ``event(E,[T1,T2])`` or ``new_event(...)``.

        What is none of these is refused with a warning, unless the settings allow any goal.
        """
        self._runner.post(self._text_input.take, text)

    def advance(self) -> None:
        """Do what has come due by the clock: alarms, and starting anew where it went back."""
        self._runner.post(self._intake.watch_clock)

    def call(self, goal: Union[str, Term]) -> bool:
        """Call a goal once; returns whether it has a solution.

        Raises:
            PrologError: what the goal raised.
        """
        term = self._read(goal)
        return self.do(lambda: self._once(term), term)

    def query(self, goal: Union[str, Term], most: Optional[int] = None) -> List[Dict[str, Term]]:
        """Return the solutions of a goal, each as its variables' values by name.

        Raises:
            SyntaxFault: for a text that is not a term.
            PrologError: what the goal raised.
        """
        if isinstance(goal, str):
            read = read_term(goal, self._logic.operators, "query")
            term, names = read.term, read.names
        else:
            term = goal
            names = {f"_{at}": var for at, var in enumerate(variables(goal))}
        return self.do(lambda: self._solutions(term, names, most), term)

    def _solutions(self, term: Term, names: Dict[str, Var], most: Optional[int]) -> List[Dict[str, Term]]:
        found: List[Dict[str, Term]] = []
        with closing(self._logic.solutions(term)) as solutions:
            for _ in solutions:
                shared: Dict[Var, Term] = {}  # a variable in two values stays one variable
                found.append({name: copy(value, shared) for name, value in names.items()})
                if most is not None and len(found) >= most:
                    break
        return found

    def do(self, work: Callable[[], Result], what: Term = REQUEST) -> Result:
        """Do a piece of work on the engine while nothing else does; return its result.

        Args:
            work: does it.
            what: is named where it takes long.
        """
        return self._runner.call(lambda: self._dispatcher.undisturbed(work), (what,))

    # ---- what comes out ------------------------------------------------------------------------------

    def on_output(self, callback: OnOutput) -> None:
        """Have ``callback`` called with term, topic and subscription id of each output."""
        self._outputs.append(callback)

    def on_event(self, callback: OnEvent) -> None:
        """Have ``callback`` called with term, start and end of each event, in the order of dispatch."""

        def observe(term: Term, values: Tuple[Term, ...], start: int, end: int, after: Frame) -> Frame:
            self._call_back("a callback of on_event", callback, term, start, end)
            return after

        self._dispatcher.listen(Stage.TRACE, Var(), observe)

    def show(self, term: Term) -> str:
        """Return a term as text that reads back."""
        return self._logic.show(term)

    def brief(self, term: Term) -> str:
        """Return a term as errors show it: its beginning where it is long."""
        return self._logic.brief(term)

    # ---- what is there -------------------------------------------------------------------------------

    @property
    def operators(self) -> Operators:
        """The operators by which texts are read and written; a program may add to them."""
        return self._logic.operators

    def has_memory(self, name: Term) -> bool:
        """Tell whether there is a memory with an id."""
        return self._knowledge.memories.find(name) is not None

    def has_subscription(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription with a topic and an id."""
        return self._knowledge.subscriptions.has(topic, name)

    def delete_subscription(self, topic: Term, name: Term) -> bool:
        """Delete the subscription with a topic and an id; return whether there was one."""
        return self.do(lambda: self._knowledge.subscriptions.delete(topic, name))

    def summary(self) -> str:
        """Say how many rules, memories and subscriptions there are."""
        return (
            f"{len(self._rules.rules)} event rules, {len(list(self._knowledge.memories))} memories, "
            f"{len(list(self._knowledge.subscriptions))} subscriptions"
        )

    def doubts(self, folder: Path, definitions: Definitions, types: Collection[str]) -> Iterator[RuleError]:
        """Yield a warning for each thing in the program that reads well and is probably not meant.

        Args:
            folder: the program's own.
            definitions: the message types that are known.
            types: those that the program's topics have.
        """
        yield from unread_rules(self._files, folder)
        yield from wrong_messages(self._rules, self._knowledge.patterns(), definitions, types)
        yield from unknown_memories(self._rules, [memory.id for memory in self._knowledge.memories])

    @property
    def dropped(self) -> int:
        """How many events were dropped because the queue was full."""
        return self._runner.dropped

    # ---- inside --------------------------------------------------------------------------------------

    def _read(self, term: Union[str, Term]) -> Term:
        return read_term(term, self._logic.operators, "text").term if isinstance(term, str) else term

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


def parts_of(engine: Engine) -> EngineParts:
    """Return what an engine is made of, for those rooms and tests that look inside; programs need none of it."""
    return EngineParts(
        engine._logic,  # noqa: SLF001
        engine._dispatcher,  # noqa: SLF001
        engine._rules,  # noqa: SLF001
        engine._knowledge,  # noqa: SLF001
        engine._reports,  # noqa: SLF001
        engine._runner,  # noqa: SLF001
        engine._watchdog,  # noqa: SLF001
    )
