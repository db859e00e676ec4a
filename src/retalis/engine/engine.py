"""The engine: composition of the components of a running program, and its public interface."""

import os
from contextlib import closing
from pathlib import Path
from typing import (
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    Type,
    TypeVar,
    Union,
)

from ..events.checks.check_registry import INFO, look_through
from ..events.checks.program_model import ProgramModel
from ..events.dispatch.dispatcher import Dispatcher
from ..events.dispatch.listeners import ListenerPhase
from ..events.knowledge.knowledge_base import DELETE_MEMORY, MEMORIZE, OWN_EVENTS, SUBSCRIBE, KnowledgeBase
from ..events.program.program_folder import Topics, TopicType
from ..events.rules.event_predicates import define_new_event
from ..events.rules.rule_base import RuleBase
from ..foundation.errors import RetalisError, UsageError, counted
from ..messages.field_names import SlotNames
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import MEGABYTE
from ..prolog.swi.use_swi import define_use_swi
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.system.foreign_functions import define_foreign, define_use_foreign
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.term_traversal import copy, variables
from ..prolog.terms.timestamps import WholeSeconds
from ..prolog.terms.types import Frame, Functor, Term, Var
from ..serialization.state_sections import pack, read_records, unpack
from .deployment import Deployment
from .engine_settings import Settings
from .engine_snapshot import EngineSnapshot, checked, clock_for, coded, decoded
from .engine_status import DEFAULT_LISTED, EngineView, Status, StatusReader
from .event_input import EventInput, InputTopics, TextInput
from .hot_reload import NullReports, clock_at, load_folder, reload_folder, trial_settings
from .program_loader import REQUEST, ProgramLoader
from .runtime.clock import Clock, StreamClock
from .runtime.gc_tuning import count_records_of
from .runtime.problem_reports import Reports
from .runtime.serial_executor import EngineRecovery, SerialExecutor
from .runtime.watchdog import watch


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

Instant = Union[int, Term]
Result = TypeVar("Result")
Made = TypeVar("Made", bound="Engine")


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

    In a forked process (``os.fork``, ``multiprocessing``) an engine goes on by itself. If another thread was at work
    in it at that moment, its calls raise a `UsageError` there.

    >>> engine = Engine()
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", goals="subscribe(alarm(_), [], _, alarms, a)")
    >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
    >>> engine.event("smoke(kitchen)", 1, 1)
    >>> engine.event("heat(kitchen)", 2, 2)
    alarms alarm(kitchen)

    Args:
        clock: what time it is; by default a `StreamClock` that follows the stamps of events and never goes back.
        settings: limits and sizes.
        reports: takes what goes wrong while events flow; by default it is logged.
        definitions: the message types whose slots a program may name; by default those that are installed.

    Attributes:
        clock: the time of the program.
        settings: limits and sizes.

    The components are attributes, too, for the other packages of retalis: ``logic`` (Prolog), ``dispatcher``,
    ``rules``, ``knowledge`` (memories, queries, subscriptions), ``reports``, ``executor``, ``watchdog``, ``loader``,
    ``slots`` (field names of messages), ``deployments`` (the loaded folders), ``input_topics`` and ``event_input``.
    They are not part of the public interface and may change in any version.
    """

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
        self.logic = PrologSystem()
        self.slots = self.logic.operators.slots = SlotNames(definitions)
        self._budget = budget = self.logic.machine.budget
        self.logic.limits = settings.limits
        self.logic.allow_flags = settings.allow_flags
        self.logic.now = self.clock.now
        self.dispatcher = Dispatcher(self.logic, max_depth=settings.max_depth)
        self.reports = reports = Reports() if reports is None else reports
        # Rules and knowledge need each other: the rules get functions that find the knowledge when they are called.
        self.rules = RuleBase(
            self.logic,
            self.dispatcher,
            self.clock,
            on_error=reports.error,
            on_warning=reports.warning,
            on_reset=lambda past: self.knowledge.reset(past),
            is_external_event=lambda key: key in OWN_EVENTS or key.name in self.slots.events,
        )
        declared = self.rules.declared
        self._files = self.rules.files
        self._files.door.allow(
            settings.folders, settings.write_folders, settings.max_file_megabytes * MEGABYTE
        )
        self.knowledge = KnowledgeBase(
            self.logic,
            self.dispatcher,
            self.clock,
            self._deliver,
            reports.warning,
            self.rules,
            on_pattern=declared.require,
            on_conditions=self.rules.note_conditions,
        )
        self.rules.flags.follow("max_gap", self.knowledge.gaps.limit)
        if settings.max_gap is not None:
            self.rules.flags.set_default("max_gap", settings.max_gap)
        recovery = EngineRecovery(self.logic, self.dispatcher, self.rules, self.knowledge)
        self.executor = SerialExecutor(
            settings.queue, self._report_drop, reports.error, recovery, settings.patience
        )
        budget.count_for(self.executor)
        self.watchdog = watch(self.executor, self.logic, self.dispatcher, reports, settings.watchdog)
        call = self._call_undisturbed if settings.allow_goals else None
        self.event_input = EventInput(self.logic, self.dispatcher, self.clock, followed, self._start_anew)
        self._take = self.event_input.take  # bound once: one step less for each event
        self._message = self.event_input.take_message
        self._text_input = TextInput(self.logic.operators, self._take, call, reports, declared)
        self._outputs: List[OnOutput] = []
        self._observed = False
        self._foreign: List[Tuple[object, ...]] = []
        self.deployments: Dict[str, Deployment] = {}
        """What the folder of a program has made, by its real path."""
        self.loader = ProgramLoader(
            self.logic, self.rules, self.executor, self.dispatcher, settings.limit_start, self._once
        )
        self._status = StatusReader(
            EngineView(
                self.logic,
                self.dispatcher,
                self.rules,
                self.knowledge,
                self.clock,
                reports,
                self.executor,
                self.watchdog,
                lambda: self.event_input.taken,
                settings.queue,
            )
        )
        count_records_of(self._status)
        define_new_event(self.logic, self.dispatcher)
        self.input_topics = InputTopics(self.logic, self.slots, reports)
        define_use_foreign(self.logic, self.executor, self._files, settings.allow_foreign)
        if settings.allow_foreign:  # Python may read it all the same
            self.logic.environment = os.environ
        define_use_swi(self.logic, self._files, settings.allow_swi, reports.warning)

    # ---- loading -------------------------------------------------------------------------------------

    def load(
        self, rules: str = "", goals: str = "", source: str = "text", folder: Optional[Path] = None
    ) -> None:
        """Load goals and then rules from texts.

        >>> engine = Engine()
        >>> engine.load(rules="alarm <- fire.", goals="memorize(fire, [], _, fires, 10)")

        Args:
            rules: an event file's text.
            goals: a goal file's text.
            source: what errors call them.
            folder: the program's own, which its goals may read from then on, and where relative paths start;
                without one the texts name files from the working directory on, and later goals read nothing.

        Raises:
            ProgramErrors: all errors; goals before a failed one have been called, of wrong rules none is active.
        """
        self.loader.load(rules, goals, source, folder)

    def load_rules(self, text: str, source: str = "text", folder: Optional[Path] = None) -> None:
        """Load the text of an event file; see `load`.

        >>> Engine().load_rules("alarm <- fire seq smoke.", "mine")

        Raises:
            ProgramErrors: all errors; nothing of the text is active then. What is wrong in a text without event rules
                is left out, with a warning (an `Omission`), where anything of it is left.
        """
        self.loader.load_rules(text, source, folder)

    def load_program(self, folder: Union[str, Path]) -> None:
        """Call the goals of ``goalPredicates.txt`` in a program's folder; they name the rule files.

        Given a file in place of a folder, load that event file.

        >>> engine = Engine()
        >>> engine.load_program(folder)

        Raises:
            ProgramErrors: the goals that did not read, failed or raised; the others have been called.
            UsageError: where the file cannot be read.
        """
        load_folder(self, Path(folder))

    def reload(self, folder: Union[str, Path]) -> List[str]:
        """Read a program's folder again, all or nothing: what `load_program` has made of it goes, and what it says
        now comes; return what has changed, a line each.

        Memories keep their records where their definition is the same, rules that say the same what waits in them.
        What was added since by others or at run time stays. The folder is loaded twice: first into another engine
        with these settings, so that errors leave this one untouched. So its goals are called twice, and what they do
        outside of an engine is done twice. The limits of a request hold for each time. An event file in place of a
        folder is loaded once, into this engine.

        >>> engine = Engine()
        >>> engine.load_program(folder)
        >>> engine.reload(folder)[0].partition(",")[0]
        'rules: 0 new'

        Raises:
            ProgramErrors: what is wrong; the program is what it was.
            UsageError: where a file cannot be read, or a goal or callback of this engine calls it.
        """
        return reload_folder(self, Path(folder), self._trial)

    def _trial(self) -> "Engine":
        """Return another engine with these settings, for which it is as late."""
        trial = Engine(
            clock_at(self.clock.now()), trial_settings(self.settings), NullReports(), self.slots.definitions
        )
        trial.input_topics.try_out(self.input_topics)
        for sources in self._foreign:
            trial.add_foreign(*sources)
        return trial

    def call_goals(self, text: str, source: str, folder: Optional[Path] = None) -> None:
        """Call the goals of a goal file one after the other; see `load`.

        >>> Engine().call_goals("memorize(fire, [], _, fires, 10)", "mine")

        Raises:
            ProgramErrors: all that did not read, failed or raised; the others have been called.
        """
        self.loader.call_goals(text, source, folder)

    # ---- events --------------------------------------------------------------------------------------

    def event(
        self, term: Union[str, Term], start: Optional[Instant] = None, end: Optional[Instant] = None
    ) -> None:
        """Take an event and return when all that follows from it is done.

        >>> engine = Engine()
        >>> engine.event("fire(kitchen)", 1.5, 2)
        >>> engine.event(functor("fire", 1)(atom("hall")))
        >>> Engine(clock=Clock()).event("fire(kitchen)")

        Args:
            term: the event, as a term or its text.
            start: when it began: a stamp term or a number of seconds; by default now, by the clock.
            end: when it ended; as ``start`` by default.

        Raises:
            UsageError: for a wrong stamp, an end before the start, what does not fit the event's declaration, or no
                start if the clock was never set, as that of an engine without a clock of its own is not before the
                first event that has a time.
            SyntaxFault: for a text that is not a term.
        """
        first = None if start is None else timestamps.from_any(start)
        last = first if end is None else timestamps.from_any(end)
        self.event_at(self._read(term, MADE), first, last)

    def event_at(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        """Take an event whose interval is given as instants in nanoseconds; see `event`.

        >>> Engine().event_at(atom("fire"), 1_500_000_000, 2_000_000_000)
        """
        self.executor.call(lambda: self._take_fitting(term, start, end), (term,))

    def post(self, term: Term, instant: Optional[int] = None) -> None:
        """Queue a message and return without waiting for others.

        >>> Engine().post(functor("battery", 1)(87), 1_500_000_000)

        Args:
            term: the event, without variables.
            instant: when it happened, in nanoseconds; by default now, by the clock.
        """
        if instant is None:
            self.executor.post(self._message, term)
        else:
            stamped = WholeSeconds(instant)  # the form in which the converter writes it
            self.executor.post(self._take, term, stamped, stamped, True)

    def post_each(self, messages: Iterable[Tuple[Term, Optional[int]]]) -> None:
        """Queue messages as `post` does, in less time: for those that are there together.

        >>> battery = functor("battery", 1)
        >>> Engine().post_each([(battery(87), 1_500_000_000), (battery(86), None)])

        Args:
            messages: events without variables, each with the instant when it happened, in nanoseconds; None for now.
                Asked for the next one when the one before is done, or queued behind others; must not use the engine.
                What asking raises is raised here, when all before it is done.
        """
        self.executor.post_each(self._message, messages)

    def post_text(self, text: str) -> None:
        """Queue an event as other nodes send it: ``event(E)``, ``event(E,[T1,T2])`` or ``new_event(...)``.

        What is none of these is refused with a warning, unless the settings allow any goal.

        >>> Engine().post_text("event(fire(kitchen), [1.5,2])")
        """
        self.executor.post(self._text_input.take, text)

    def advance(self, move: Optional[Callable[[], object]] = None) -> None:
        """Do what has come due by the clock: alarms, and starting anew where it went back.

        >>> engine = Engine(StreamClock())
        >>> engine.clock.move_to(1_000_000_000)
        >>> engine.advance()

        Args:
            move: moves the clock first, when all that was posted before has been taken.
        """
        self.executor.post(self.event_input.watch_clock, move)

    def call(self, goal: Union[str, Term]) -> bool:
        """Call a goal once; returns whether it has a solution.

        >>> engine = Engine()
        >>> engine.call("assertz(room(hall))"), engine.call("room(attic)")
        (True, False)

        Raises:
            PrologError: what the goal raised.
        """
        term = self._read(goal)
        return self.do(lambda: self._once(term), term)

    def query(self, goal: Union[str, Term], most: Optional[int] = None) -> List[Dict[str, Term]]:
        """Return the solutions of a goal, each as its variables' values by name.

        >>> Engine().query("member(X, [1, 2, 3])", most=2)
        [{'X': 1}, {'X': 2}]

        Raises:
            SyntaxFault: for a text that is not a term.
            PrologError: what the goal raised.
        """
        if isinstance(goal, str):
            read = read_term(goal, self.logic.operators, "query")
            term, names = read.term, read.names
        else:
            term = goal
            names = {f"_{at}": var for at, var in enumerate(variables(goal))}
        return self.do(lambda: self._solutions(term, names, most), term)

    def do(self, work: Callable[[], Result], what: Term = REQUEST) -> Result:
        """Do a piece of work on the engine while nothing else does; return its result.

        >>> engine = Engine()
        >>> engine.do(lambda: engine.call("assertz(door(open))") and engine.query("door(X)"))
        [{'X': atom('open')}]

        Args:
            work: does it.
            what: is named where it takes long.
        """
        return self.executor.call(lambda: self.dispatcher.undisturbed(work), (what,))

    # ---- what comes out ------------------------------------------------------------------------------

    def on_output(self, callback: OnOutput) -> None:
        """Have ``callback`` called with term, topic and subscription id of each output.

        >>> engine = Engine()
        >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
        >>> engine.load(goals="subscribe(fire(_), [], _, alarms, a)")
        >>> engine.event("fire(hall)", 1)
        alarms fire(hall)
        """
        self._outputs.append(callback)

    def on_event(self, callback: OnEvent) -> None:
        """Have ``callback`` called with term, start and end of each event, in the order of dispatch.

        >>> engine = Engine()
        >>> engine.on_event(lambda term, start, end: print(engine.show(term), end))
        >>> engine.event("fire(hall)", 1)
        fire(hall) 1000000000
        """

        def observe(term: Term, values: Tuple[Term, ...], start: int, end: int, after: Frame) -> Frame:
            self._call_back("a callback of on_event", callback, term, start, end)
            return after

        self.dispatcher.listen(ListenerPhase.TRACE, Var(), observe)
        self._observed = True

    def show(self, term: Term) -> str:
        """Return a term as text that reads back.

        >>> Engine().show(functor("said", 1)(atom("Good day")))
        "said('Good day')"
        """
        return self.logic.show(term)

    def brief(self, term: Term) -> str:
        """Return a term as errors show it: its beginning where it is long.

        >>> len(Engine().brief(make_list(range(10000)))) < 1000
        True
        """
        return self.logic.brief(term)

    # ---- what is there -------------------------------------------------------------------------------

    @property
    def operators(self) -> Operators:
        """The operators by which texts are read and written; a program may add to them.

        >>> engine = Engine()
        >>> engine.call("op(700, xfx, near)"), "near" in engine.operators
        (True, True)
        """
        return self.logic.operators

    def output_topics(self) -> List[str]:
        """Return the topics to which subscriptions send, in the order of the alphabet.

        >>> engine = Engine()
        >>> engine.load(goals="subscribe(fire, [], _, alarms, a)")
        >>> engine.output_topics()
        ['alarms']
        """
        return sorted({topic for topic, _ in self.knowledge.subscriptions})

    def summary(self) -> str:
        """Say how many rules, memories and subscriptions there are.

        >>> Engine().summary()
        '0 event rules, 0 memories, 0 subscriptions'
        """
        return (
            f"{counted(len(self.rules.rules), 'event rule')}, "
            f"{counted(len(list(self.knowledge.memories)), 'memory', 'memories')}, "
            f"{counted(len(list(self.knowledge.subscriptions)), 'subscription')}"
        )

    def warnings(
        self,
        folder: Path,
        definitions: Definitions,
        topics: Optional[Topics] = None,
        direct: Iterable[TopicType] = (),
    ) -> Iterator[RetalisError]:
        """Yield a warning for each thing in the program that reads well and is probably not meant.

        >>> engine = Engine()
        >>> engine.load(rules="alarm <- fire where prev(fires, _, 1, 2, _). fire <- fire.")
        >>> [warning.message.partition(":")[0] for warning in engine.warnings(folder, Definitions())][-1]
        'fire/0 fires itself, at once and without end'

        Args:
            folder: the program's own.
            definitions: the message types that are known.
            topics: the program's; by default none.
            direct: further topics that become events.
        """
        topics = self.input_topics.joined(Topics() if topics is None else topics)
        program = ProgramModel(
            self.rules, self.knowledge, definitions, topics, tuple(direct), folder, self._observed
        )
        return (finding.problem for finding in look_through(program) if finding.severity != INFO)

    def status(self, most: int = DEFAULT_LISTED) -> Status:
        """Tell what the engine is doing and what it holds.

        It does not wait for the engine: where that is busy, ``work`` says with what and for how long.

        >>> engine = Engine()
        >>> engine.load(rules="alarm <- fire.", goals="memorize(alarm, [], _, alarms, 10)")
        >>> engine.event("fire", 1)
        >>> status = engine.status()
        >>> status.taken, status.rules[0].fired, status.memories[0].records, status.work
        (1, 1, 1, None)

        Args:
            most: how many rules, memories, subscriptions and queries are listed; the others are counted.
        """
        return self._status.read(most)

    @property
    def dropped(self) -> int:
        """How many events were dropped because the queue was full.

        >>> Engine().dropped
        0
        """
        return self.executor.dropped

    # ---- memories and subscriptions ----

    def has_memory(self, name: Term) -> bool:
        """Tell whether there is a memory with an id.

        >>> engine = Engine()
        >>> engine.load(goals="memorize(fire, [], _, fires, 10)")
        >>> engine.has_memory(atom("fires"))
        True
        """
        return self.knowledge.memories.find(name) is not None

    def add_memory(
        self, event: Term, conditions: Sequence[Term], record: Term, name: Term, size: Term
    ) -> None:
        """Add a memory as goal ``memorize/5`` does: under its limits, and with the events that tell of it.

        >>> engine = Engine()
        >>> engine.add_memory(atom("fire"), [], atom("fire"), atom("fires"), 10)
        >>> engine.has_memory(atom("fires"))
        True

        Args:
            event: the pattern of the events that it keeps.
            conditions: goals, which share variables with the pattern.
            record: what it keeps of an event; a variable for the event itself.
            name: its id.
            size: how many records it keeps.

        Raises:
            PrologError: where there is one of this id, or these are not what a memory is made of.
        """
        self._achieve((MEMORIZE, event, make_list(conditions), record, name, size))

    def delete_memory(self, name: Term) -> bool:
        """Delete the memory with an id, as goal ``delete_memory/1`` does; return whether there was one.

        >>> Engine().delete_memory(atom("fires"))
        False
        """

        def work() -> bool:  # nobody deletes it in between
            found = self.has_memory(name)
            if found:
                self._achieve((DELETE_MEMORY, name))
            return found

        return self.executor.call(lambda: self.dispatcher.undisturbed(work), (REQUEST,))

    def has_subscription(self, topic: Term, name: Term) -> bool:
        """Tell whether there is a subscription with a topic and an id.

        >>> engine = Engine()
        >>> engine.load(goals="subscribe(fire, [], _, alarms, a)")
        >>> engine.has_subscription(atom("alarms"), atom("a"))
        True
        """
        return self.knowledge.subscriptions.has(topic, name)

    def add_subscription(
        self, event: Term, conditions: Sequence[Term], form: Term, topic: Term, name: Term
    ) -> None:
        """Add a subscription as goal ``subscribe/5`` does; see `add_memory`.

        >>> engine = Engine()
        >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
        >>> engine.add_subscription(atom("fire"), [], atom("burning"), atom("alarms"), atom("a"))
        >>> engine.event("fire", 1)
        alarms burning

        Args:
            event: the pattern of the events that go out.
            conditions: goals, which share variables with the pattern.
            form: what goes out for an event; a variable for the event itself.
            topic: where to.
            name: its id; together with the topic it is the only one.

        Raises:
            PrologError: where there is one of this topic and id, or these are not what a subscription is made of.
        """
        self._achieve((SUBSCRIBE, event, make_list(conditions), form, topic, name))

    def delete_subscription(self, topic: Term, name: Term) -> bool:
        """Delete the subscription with a topic and an id; return whether there was one.

        >>> Engine().delete_subscription(atom("alarms"), atom("a"))
        False
        """
        return self.executor.call(
            lambda: self.dispatcher.undisturbed(lambda: self.knowledge.subscriptions.delete(topic, name)),
            (REQUEST,),
        )

    # ---- state ----

    def snapshot(self) -> bytes:
        """Return all that the engine knows and that waits in it, as bytes: see docs/state.md.

        >>> engine = Engine()
        >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).")
        >>> engine.event("smoke(kitchen)", 1)
        >>> other = Engine.restore(engine.snapshot())
        >>> other.on_event(lambda term, start, end: print(other.show(term), end))
        >>> other.event("heat(kitchen)", 2)
        heat(kitchen) 2000000000
        alarm(kitchen) 2000000000

        Raises:
            UsageError: where a goal or callback of this engine calls it.
        """

        def work() -> Dict[str, bytes]:
            # To bytes while nothing else is done: what is asked binds variables of rules for a while.
            keeper = EngineSnapshot(self)
            return coded(keeper.take(), keeper.records())

        return pack(self.executor.call(lambda: self.dispatcher.undisturbed(work), (REQUEST,)))

    @classmethod
    def restore(
        cls: Type[Made],
        data: bytes,
        clock: Optional[Clock] = None,
        settings: Optional[Settings] = None,
        reports: Optional[Reports] = None,
        definitions: Optional[Definitions] = None,
        foreign: Tuple[object, ...] = (),
        folder: Optional[Path] = None,
    ) -> Made:
        """Return a new engine that goes on where the one was whose `snapshot` this is.

        It has the program, memories, partial matches, waiting queries, alarms and counters. Callbacks have to be
        given again, as all that is not of the program.

        >>> engine = Engine()
        >>> engine.load(goals="memorize(fire(_), [], _, fires, 10)")
        >>> engine.event("fire(hall)", 1)
        >>> Engine.restore(engine.snapshot()).query("memory_size(fires, N), memory_counter(fires, C)")
        [{'N': 10, 'C': 1}]

        Args:
            data: from `snapshot`.
            clock: as for a new engine; by default one that goes on from the instant of the other's.
            settings: as for a new engine; they are not part of the state.
            reports: as for a new engine.
            definitions: as for a new engine.
            foreign: what `add_foreign` was given.
            folder: the program's, from which Python modules may be loaded again that it had asked for.

        Raises:
            UsageError: for what is no state, is damaged, or comes from another version.
        """
        found = checked(lambda: unpack(data))
        sections = checked(lambda: decoded(found))

        def work() -> Made:
            engine = cls(clock or clock_for(sections["run"]), settings, reports, definitions)
            if foreign:
                engine.add_foreign(*foreign)
            records = [[read_records(data)] for name, data in found.items() if name.startswith("memory ")]
            EngineSnapshot(engine).take_up(sections, records, folder)
            return engine

        return checked(work)

    def add_foreign(self, *sources: object) -> List[Functor]:
        """Define Python functions that have the decorator `foreign`, and those of modules, as predicates.

        >>> @foreign
        ... def half(number: int) -> float:
        ...     return number / 2
        >>> Engine().add_foreign(half)
        [functor('half', 2)]

        Returns:
            The functors of the predicates.

        Raises:
            UsageError: for a function without the decorator, or a module in which none has it.
            PrologError: where a predicate of the system has that name.
        """
        found = self.executor.call(lambda: define_foreign(self.logic, self.executor, *sources))
        self._foreign.append(sources)
        return found

    # ---- implementation ----

    def _take_fitting(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        """Take an event that is no message of a topic.

        Raises:
            UsageError: where it does not fit its declaration.
        """
        declared = self.rules.declared
        wrong = declared.refusal(term) if declared.in_use else ""
        if wrong:
            raise UsageError(f"event refused: {wrong}")
        self._take(term, start, end)

    def _read(self, term: Union[str, Term], flags: ReadFlags = READ) -> Term:
        return read_term(term, self.logic.operators, "text", flags).term if isinstance(term, str) else term

    def _once(self, goal: Term) -> bool:
        """Call a goal once; where nothing else is under way nobody will undo its bindings: no trail of them stays."""
        machine = self.logic.machine
        outermost = not machine.trail and not machine.choices and self.dispatcher.current is None
        try:
            return self.logic.once(goal)
        finally:
            if outermost:
                machine.trail.clear()

    def _call_undisturbed(self, goal: Term) -> bool:
        return self.dispatcher.undisturbed(lambda: self._once(goal))

    def _start_anew(self) -> None:
        """Forget what waits and what is remembered: time went back."""
        self.knowledge.clear()
        self.rules.clear()

    def _deliver(self, term: Term, topic: str, name: Term) -> None:
        for callback in self._outputs:
            self._call_back("a callback of on_output", callback, term, topic, name)

    def _call_back(self, what: str, callback: Callable[..., object], *arguments: object) -> None:
        runner = self.executor
        outer = runner.callback
        runner.callback = (what,)
        try:
            callback(*arguments)
        except Exception as error:  # a subscriber's own fault must not cut off what follows of the event
            self.reports.error(error)
        runner.callback = outer

    def _report_drop(self, dropped: int) -> None:
        self.reports.warning(
            f"events come in faster than they can be processed: {dropped} dropped so far", "dropped"
        )

    def _solutions(self, term: Term, names: Dict[str, Var], most: Optional[int]) -> List[Dict[str, Term]]:
        found: List[Dict[str, Term]] = []
        with closing(self.logic.solutions(term)) as solutions:
            for _ in solutions:
                # A variable in two values stays one variable. The copies count for the goal.
                shared: Dict[Var, Term] = {}
                with self.logic.machine.budget.watching():
                    found.append({name: copy(value, shared) for name, value in names.items()})
                if most is not None and len(found) >= most:
                    break
        return found

    def _achieve(self, goal: Term) -> None:
        """Call a goal that has to have a solution."""
        if not self.executor.call(lambda: self._call_undisturbed(goal), (goal,)):
            raise UsageError(f"{self.logic.brief(goal)} fails")
