"""The engine: composition of the components of a running program, and its public interface."""

from contextlib import closing
from itertools import islice
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
    Set,
    Tuple,
    Type,
    TypeVar,
    Union,
)

from ..events.checks.check_runner import INFO, run_checks
from ..events.checks.program_model import ProgramModel
from ..events.clock.clock import Clock, StreamClock
from ..events.dispatch.listeners import ListenerPhase
from ..events.knowledge.knowledge_base import DELETE_MEMORY, MEMORIZE, SUBSCRIBE
from ..events.program.topic_configuration import Topics, TopicType
from ..foundation.displayed_text import format_count
from ..foundation.errors import RetalisError, UsageError
from ..foundation.garbage_collection import add_live_records
from ..foundation.ros_name_checks import strip_slashes
from ..messages.transform_messages import TransformMessage
from ..messages.type_definition import SerializationFormat
from ..messages.type_registry import Definitions
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.system.foreign_functions import define_foreign
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.term_traversal import copy, variables
from ..prolog.terms.timestamps import FloatSeconds
from ..prolog.terms.types import Frame, Functor, Term, Var
from ..serialization.codec import from_bytes
from ..serialization.columns import decode_records
from ..serialization.state_file_format import changes_since, pack_sections, unpack_sections
from ..serialization.stored_field_types import ReadContext
from .engine_parts import EngineParts
from .engine_settings import Settings
from .engine_snapshot import EngineSnapshot, convert_errors, create_clock, decode_sections, encode_state
from .engine_status import DEFAULT_LISTING_LIMIT, Status
from .event_input import Subscribe
from .hot_reload import NullReports, create_fixed_clock, create_trial_settings, reload_folder
from .loaded_items import Deployment
from .program_loader import ProgramLoader, resolve_path
from .redelivered_messages import IdentifiedMessage
from .ros_param_predicate import ReadParameter
from .runtime.problem_reports import Reports
from .runtime.serial_executor import UNNAMED_REQUEST
from .service_calls import CallService


class OnOutput(Protocol):
    """A callback for `Engine.on_output`: called with the term, the topic and the subscription id of each output.

    >>> def tell(term: Term, topic: str, name: Term) -> None:
    ...     print(topic, engine.show(term), engine.show(name))
    >>> engine = Engine()
    >>> engine.on_output(tell)
    >>> engine.load(goals="subscribe(bark(Dog), [], Dog, dogs, first)")
    >>> engine.event("bark(rex)", 1)
    dogs rex first
    """

    def __call__(self, term: Term, topic: str, name: Term, /) -> object:
        """Process an output."""


class OnEvent(Protocol):
    """A callback for `Engine.on_event`: called with the term, start and end (ns since the epoch) of each event.

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
        """Process an event."""


TERM_FLAGS = ReadFlags()
"""Read flags for goals and patterns."""

EVENT_FLAGS = ReadFlags(is_constructed=True)

Instant = Union[int, Term]
"""A time: a number of seconds since the epoch, or a timestamp term."""
Result = TypeVar("Result")
EngineType = TypeVar("EngineType", bound="Engine")


class Engine:
    """A running program.

    Events are given to the engine (`event`, `post`), outputs are passed to callbacks (`on_output`), and queries are
    answered (`query`). Methods may be called from any thread; the engine executes one call at a time. An error in a
    rule, goal or callback is logged (logger ``retalis``) with its place, and does not affect other rules.

    A callback (`on_output`, `on_event`, a foreign predicate) may call the engine, and any thread may `post`. A
    callback must not wait for another thread that calls the engine, because that thread waits for the callback. If it
    does, the other thread gets a `UsageError` after the callback has taken ``settings.patience`` seconds.

    Ctrl-C while the engine works leaves it half changed, and it then refuses all further calls. Within
    `deferred_interrupts` Ctrl-C ends the current event or goal at a safe point: effects that have occurred remain,
    consequences that have not been derived are omitted, and later events are processed normally.

    In a forked process (``os.fork``, ``multiprocessing``) the engine continues independently. If another thread was
    using it at the time of the fork, calls raise a `UsageError` in the new process.

    >>> engine = Engine()
    >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).", goals="subscribe(alarm(_), [], _, alarms, a)")
    >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
    >>> engine.event("smoke(kitchen)", 1, 1)
    >>> engine.event("heat(kitchen)", 2, 2)
    alarms alarm(kitchen)

    Args:
        clock: the time of the program; by default a `StreamClock` that follows the timestamps of events, and returns
            from a wrong one; see docs/explanation/how-it-works.md.
        settings: limits and sizes.
        reports: receives errors and warnings while events are processed; by default they are logged.
        definitions: the message types whose fields a program may name; by default the installed ones.

    Attributes:
        clock: the time of the program.
        settings: limits and sizes.
        program: predicates, rules, knowledge and loader, for other packages of retalis.

    The parts are attributes, too, for tests: ``logic`` (Prolog), ``dispatcher``, ``rules``, ``knowledge`` (memories,
    queries, subscriptions), ``reports``, ``executor``, ``watchdog``, ``deployments`` (the loaded folders),
    ``input_topics`` and ``event_input``. Like ``program``, they are not part of the public interface and may change
    in any version.
    """

    def __init__(
        self,
        clock: Optional[Clock] = None,
        settings: Optional[Settings] = None,
        reports: Optional[Reports] = None,
        definitions: Optional[Definitions] = None,
    ):
        settings = Settings() if settings is None else settings
        settings.check()
        parts = self._parts = EngineParts(
            StreamClock(follows_events=True) if clock is None else clock,
            settings,
            Reports() if reports is None else reports,
            definitions,
        )
        self.clock, self.settings = parts.clock, parts.settings
        self.program = parts.program
        self.logic, self.rules, self.knowledge = parts.logic, parts.rules, parts.knowledge
        self.dispatcher, self.executor, self.reports = parts.dispatcher, parts.executor, parts.reports
        self.event_input, self.input_topics = parts.event_input, parts.input_topics
        self.deployments, self.watchdog = parts.loader.deployments, parts.watchdog
        # Bound once, which saves an attribute access per event.
        self._dispatch_event = parts.event_input.dispatch_event
        self._dispatch_message = parts.event_input.dispatch_message
        self._status_reader = parts.status_reader
        self._has_event_callbacks = False
        self._incomplete_folders: Set[str] = set()
        """Real paths of folders whose last load had an error, for which checks would report missing rules."""
        self._foreign_sources: List[Tuple[object, ...]] = []
        """Arguments of the calls of `add_foreign`, which are repeated for a trial engine."""
        # The garbage collector counts the records as live heap, see `garbage_collection`.
        add_live_records(self._status_reader.count_records)

    # ---- loading -------------------------------------------------------------------------------------

    def load(
        self, rules: str = "", goals: str = "", source: str = "text", folder: Optional[Path] = None
    ) -> None:
        """Load goals and then rules from texts.

        >>> engine = Engine()
        >>> engine.load(rules="alarm <- fire.", goals="memorize(fire, [], _, fires, 10)")

        Args:
            rules: text of an event file.
            goals: text of a goal file.
            source: name of the texts in errors.
            folder: folder of the program: later goals may read files in it, and relative paths start there. Without a
                folder, paths start in the working directory and later goals may not read files.

        Raises:
            ProgramErrors: all errors. Goals before a failed one have been called. If a rule is wrong, no rule of the
                text is active.
        """
        self._parts.loader.load(rules, goals, source, folder)

    def load_rules(self, text: str, source: str = "text", folder: Optional[Path] = None) -> None:
        """Load the text of an event file; see `load`.

        >>> Engine().load_rules("alarm <- fire seq smoke.", "mine")

        Raises:
            ProgramErrors: all errors; nothing of the text is active. In a text without event rules, wrong clauses are
                omitted with a warning (an `Omission`) if any clause is accepted.
        """
        self._parts.loader.load_rules(text, source, folder)

    def load_program(self, folder: Union[str, Path]) -> None:
        """Call the goals of ``goalPredicates.txt`` in a program's folder; these goals name the rule files.

        If the path is a file, load it as an event file.

        >>> engine = Engine()
        >>> engine.load_program(folder)

        Raises:
            ProgramErrors: the goals that have a syntax error, fail or raise; the other goals have been called.
            UsageError: if the file cannot be read.
        """
        key = resolve_path(Path(folder))
        self._incomplete_folders.add(key)
        self._parts.loader.load_folder(Path(folder))
        self._incomplete_folders.discard(key)

    def reload(self, folder: Union[str, Path]) -> List[str]:
        """Load a program's folder again in one transaction, and return a description of the changes, one per line.

        Everything that `load_program` has created from the folder is replaced. A memory with an unchanged definition
        keeps its records, and an unchanged rule keeps its partial matches. Anything that was added by services or at
        run time remains. The folder is loaded twice, first into a separate engine with the same settings, so that
        errors do not affect this engine. Its goals are therefore called twice, and their external effects occur
        twice. The limits of a request apply to each load. An event file is loaded once, into this engine.

        >>> engine = Engine()
        >>> engine.load_program(folder)
        >>> engine.reload(folder)[0].partition(",")[0]
        'rules: 0 new'

        Raises:
            ProgramErrors: all errors; the program is unchanged.
            UsageError: if a file cannot be read, or if a goal or callback of this engine calls this method.
        """
        changes = reload_folder(self._parts.loader, self.executor, Path(folder), self._create_trial)
        self._incomplete_folders.discard(resolve_path(Path(folder)))
        # The constants of these types have their values now.
        self._parts.slots.pop_known()
        return changes

    def pop_late_types(self) -> List[str]:
        """Return the message types that were defined after the program was loaded, and whose constants it names.

        These constants have no values until the program is loaded again, see `reload`. Each type is returned once.

        >>> Engine().pop_late_types()
        []
        """
        return self._parts.slots.pop_known()

    def _create_trial(self) -> ProgramLoader:
        """Return the loader of a second engine with the same settings, time and foreign predicates."""
        trial_engine = Engine(
            create_fixed_clock(self.clock.now()),
            create_trial_settings(self.settings),
            NullReports(),
            self._parts.slots.definitions,
        )
        trial_engine.input_topics.copy_for_trial(self.input_topics)
        trial_engine.on_parameter_read(self._parts.ros_parameters.read)
        trial_engine.on_service_call(lambda call: None)
        for sources in self._foreign_sources:
            trial_engine.add_foreign(*sources)
        return trial_engine._parts.loader  # noqa: SLF001 - the same class

    def call_goals(self, text: str, source: str, folder: Optional[Path] = None) -> None:
        """Call the goals of a goal file in order; see `load`.

        >>> Engine().call_goals("memorize(fire, [], _, fires, 10)", "mine")

        Raises:
            ProgramErrors: all goals that have a syntax error, fail or raise; the other goals have been called.
        """
        self._parts.loader.call_goals(text, source, folder)

    # ---- events --------------------------------------------------------------------------------------

    def event(
        self, term: Union[str, Term], start: Optional[Instant] = None, end: Optional[Instant] = None
    ) -> None:
        """Process an event; return when all derived events have been processed.

        >>> engine = Engine()
        >>> engine.event("fire(kitchen)", 1.5, 2)
        >>> engine.event(functor("fire", 1)(atom("hall")))
        >>> Engine(clock=Clock()).event("fire(kitchen)")

        Args:
            term: the event, as a term or its text.
            start: start time, a timestamp term or a number of seconds; by default the clock's present time.
            end: end time; by default ``start``.

        Raises:
            UsageError: for an invalid timestamp, an end before the start or without one, or an event that does not
                match its declaration. Also if there is no start and the clock was never set: a default clock is not
                set before the first event that has a time.
            SyntaxFault: if the text is not a term.
        """
        start_instant = None if start is None else timestamps.from_any(start)
        end_instant = start_instant if end is None else timestamps.from_any(end)
        self._process(self._parse_term(term, EVENT_FLAGS), start_instant, end_instant)

    def event_at(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        """Process an event with an interval in nanoseconds, or at the clock's present time; see `event`.

        >>> Engine().event_at(atom("fire"), 1_500_000_000, 2_000_000_000)
        """
        start_instant = FloatSeconds(start) if start.__class__ is int else start
        # An event without duration has one object as start and end: matches and records of it take less memory.
        if end is start or end is None:
            end_instant = start_instant
        else:
            end_instant = FloatSeconds(end) if end.__class__ is int else end
        self._process(term, start_instant, end_instant)

    def _process(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        if start is None and end is not None:
            raise UsageError(
                f"event '{self.logic.brief(term)}': it has an end and no start: give both times, or neither"
            )
        self.executor.call(lambda: self._check_and_dispatch(term, start, end), (term,))

    def post(self, term: Term, instant: Optional[int] = None) -> None:
        """Queue a message for processing and return immediately.

        >>> Engine().post(functor("battery", 1)(87), 1_500_000_000)

        Args:
            term: the event, without variables.
            instant: time of the event in nanoseconds; by default the clock's present time.
        """
        if instant is None:
            self.executor.post(self._dispatch_message, term)
        else:
            stamped = instant if instant.__class__ is int else int(instant)
            self.executor.post(self._dispatch_event, term, stamped, stamped, True)

    def post_each(self, messages: Iterable[Tuple[Term, Optional[int]]]) -> None:
        """Queue several messages; faster than calling `post` for each.

        >>> battery = functor("battery", 1)
        >>> Engine().post_each([(battery(87), 1_500_000_000), (battery(86), None)])

        Args:
            messages: events without variables, each with its time in nanoseconds or None for the present time. The
                iterable is advanced when the previous message is processed or queued; it must not use the engine. An
                exception that it raises is raised here after all previous messages are processed.
        """
        self.executor.post_each(self._dispatch_message, messages)

    def post_identified(self, messages: Iterable[Tuple[IdentifiedMessage, Optional[int]]]) -> None:
        """Queue messages as `post_each` does, without those that the restored state contains.

        >>> from retalis.engine.redelivered_messages import IdentifiedMessage
        >>> battery = IdentifiedMessage(functor("battery", 1)(87), "/battery", (1_500_000_000, 1))
        >>> engine = Engine()
        >>> engine.post_identified([(battery, 1_500_000_000)])
        >>> Engine.restore(engine.snapshot()).post_identified([(battery, 1_500_000_000)])
        """
        self.executor.post_each(self.event_input.dispatch_identified, messages)

    def post_text(self, text: str) -> None:
        """Queue an event as text: ``event(E)``, ``event(E,[T1,T2])`` or ``new_event(...)``.

        Other goals are rejected with a warning, unless the settings allow any goal.

        >>> Engine().post_text("event(fire(kitchen), [1.5,2])")
        """
        self.executor.post(self._parts.text_input.process_text, text)

    def post_transforms(
        self, messages: Iterable[Tuple[Union[Term, TransformMessage], Optional[int]]]
    ) -> None:
        """Queue messages, which may be transforms; otherwise as `post_each`.

        >>> Engine().post_transforms([(functor("battery", 1)(87), 1_500_000_000)])
        """
        self.executor.post_each(self.event_input.process_input, messages)

    def end_input(self) -> None:
        """Run the alarms that only wait for late events, because no more events will come.

        >>> Engine().end_input()
        """
        self.executor.post(self.event_input.end_input)

    def advance(self, move: Optional[Callable[[], object]] = None) -> None:
        """Run the alarms that are due, and clear the state of the program if the clock went back.

        >>> engine = Engine(StreamClock())
        >>> engine.clock.move_to(1_000_000_000)
        >>> engine.advance()

        Args:
            move: moves the clock first, after all messages that were posted before.
        """
        self.executor.post(self.event_input.process_clock_changes, move)

    def call(self, goal: Union[str, Term]) -> bool:
        """Call a goal once; return whether it has a solution.

        >>> engine = Engine()
        >>> engine.call("assertz(room(hall))"), engine.call("room(attic)")
        (True, False)

        Raises:
            PrologError: the error that the goal raised.
        """
        term = self._parse_term(goal)
        return self.do(lambda: self._parts.goals.call_once(term), term)

    def query(self, goal: Union[str, Term], most: Optional[int] = None) -> List[Dict[str, Term]]:
        """Return the solutions of a goal, each a dictionary from variable names to values.

        >>> Engine().query("member(X, [1, 2, 3])", most=2)
        [{'X': 1}, {'X': 2}]

        Args:
            goal: the goal, as a term or its text.
            most: maximum number of solutions; by default all are returned. With 0 the goal is not called.

        Raises:
            SyntaxFault: if the text is not a term.
            PrologError: the error that the goal raised.
            UsageError: if ``most`` is negative.
        """
        if most is not None and most < 0:
            raise UsageError(f"most: {most} is no number of solutions: expected 0 or more")
        if isinstance(goal, str):
            parsed_goal = read_term(goal, self.logic.operators, "query")
            term, names = parsed_goal.term, parsed_goal.names
        else:
            term = goal
            names = {f"_{position}": var for position, var in enumerate(variables(goal))}
        return self.do(lambda: self._collect_solutions(term, names, most), term)

    def do(self, work: Callable[[], Result], what: Term = UNNAMED_REQUEST) -> Result:
        """Execute a function exclusively, with no events processed meanwhile, and return its result.

        >>> engine = Engine()
        >>> engine.do(lambda: engine.call("assertz(door(open))") and engine.query("door(X)"))
        [{'X': atom('open')}]

        Args:
            work: the function.
            what: name of the work in warnings about its duration.
        """
        return self.executor.call(lambda: self.dispatcher.run_restoring_context(work), (what,))

    def do_later(self, work: Callable[[], object]) -> None:
        """Queue a function, which is executed exclusively, and return immediately; see `do`.

        >>> Engine().do_later(lambda: print("now"))
        now
        """
        self.executor.post(work)

    def change_settings(self, settings: Settings) -> None:
        """Replace settings between two events: limits, ``watchdog``, and the initial values of flags.

        A flag gets the new value only if its setting has changed.

        >>> engine = Engine(settings=Settings(limits=Limits(seconds=10)))
        >>> engine.change_settings(engine.settings._replace(limits=Limits(seconds=0.5)))
        >>> engine.settings.limits.seconds
        0.5

        Args:
            settings: the new settings.

        Raises:
            UsageError: if another setting differs, which is fixed when the engine is created; or if there are limits,
                and the engine was created without limits and outside of `deferred_interrupts`: its rules do not count
                their work.
        """
        settings.check()
        self._parts.check_settings(settings)

        def change() -> None:
            self._parts.change_settings(settings)
            self.settings = settings

        self.do(change)

    # ---- callbacks and text --------------------------------------------------------------------------

    def on_output(self, callback: OnOutput) -> None:
        """Register a callback for outputs; it is called with term, topic and subscription id.

        >>> engine = Engine()
        >>> engine.on_output(lambda term, topic, name: print(topic, engine.show(term)))
        >>> engine.load(goals="subscribe(fire(_), [], _, alarms, a)")
        >>> engine.event("fire(hall)", 1)
        alarms fire(hall)
        """
        self._parts.callbacks.on_output.append(callback)

    def on_event(self, callback: OnEvent) -> None:
        """Register a callback for all events; it is called with term, start and end in the order of dispatch.

        >>> engine = Engine()
        >>> engine.on_event(lambda term, start, end: print(engine.show(term), end))
        >>> engine.event("fire(hall)", 1)
        fire(hall) 1000000000
        """

        def observe(term: Term, values: Tuple[Term, ...], start: int, end: int, frame: Frame) -> Frame:
            self._parts.callbacks.call("a callback of on_event", callback, term, start, end)
            return frame

        self.dispatcher.listen(ListenerPhase.TRACE, Var(), observe)
        self._has_event_callbacks = True

    def on_topic_request(
        self,
        subscribe: Subscribe,
        topics: Topics = Topics(),  # noqa: B008 - immutable
        direct: Iterable[TopicType] = (),
        resolve_name: Callable[[str], str] = strip_slashes,
    ) -> None:
        """Set the function that subscribes to the topics that goals request; see `InputTopics.set_subscriber`.

        >>> engine = Engine()
        >>> engine.on_topic_request(lambda request: print(request.topic))
        >>> engine.call("subscribe_to(odom, 'nav_msgs/Odometry')")
        odom
        True
        """
        self.input_topics.set_subscriber(subscribe, topics, direct, resolve_name)

    def on_service_call(
        self, call: CallService, serialization_format: SerializationFormat = SerializationFormat.ROS1
    ) -> None:
        """Set the function that calls services for the goal ``ros_service/4``; without one, all calls fail.

        The function must not wait. It ends the pending call later, from any thread, by its method ``reply`` or
        ``fail``.

        >>> engine = Engine(Clock())
        >>> engine.on_service_call(lambda call: call.fail("the dock is occupied"))
        >>> engine.on_event(lambda term, start, end: print(engine.show(term)))
        >>> engine.call("ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, a)")
        service_call('/dock',a,std_srvs__0__Trigger_Request)
        service_failed('/dock',a,'the dock is occupied')
        True

        Args:
            call: called with each `ServiceCall`, in the engine's turn.
            serialization_format: serialization of requests and responses.
        """
        self._parts.service_calls.set_caller(call, serialization_format)

    def fail_interrupted_calls(self) -> None:
        """Fail the calls of services that had no end when this engine's state was stored.

        Their events are ``service_failed(Name, Id, Reason)``. Called once after a restoration, when the outputs of
        rules can be published.

        >>> engine = Engine(Clock())
        >>> engine.on_service_call(lambda call: None)
        >>> engine.call("ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, a)")
        True
        >>> restored = Engine.restore(engine.snapshot(), Clock())
        >>> restored.on_event(lambda term, start, end: print(restored.show(term)))
        >>> restored.fail_interrupted_calls()
        service_failed('/dock',a,'the program ended before the reply')
        """
        self._parts.service_calls.fail_interrupted()

    def on_parameter_read(self, read: ReadParameter) -> None:
        """Set the function that reads ROS parameters for the goal ``ros_param/2``.

        >>> engine = Engine()
        >>> engine.on_parameter_read({"/limit": 40.0, "/rooms": ["hall", "attic"]}.__getitem__)
        >>> engine.query("ros_param('/limit', Limit)")
        [{'Limit': 40.0}]
        >>> engine.call("ros_param('/unknown', _)")
        False

        Args:
            read: returns the value of a parameter; it raises `KeyError` if there is none, and must not wait.
        """
        self._parts.ros_parameters.set_reader(read)

    def with_requested_topics(self, topics: Topics = Topics()) -> Topics:  # noqa: B008 - immutable
        """Return topics of a program together with those that its goals have requested.

        >>> engine = Engine()
        >>> engine.on_topic_request(lambda request: None)
        >>> engine.call("subscribe_to(odom, 'nav_msgs/Odometry')")
        True
        >>> engine.with_requested_topics().subscribed
        (TopicType(topic='odom', type='nav_msgs/Odometry'),)
        """
        return self.input_topics.merge_with(topics)

    def show(self, term: Term) -> str:
        """Return a term as text that can be read back.

        >>> Engine().show(functor("said", 1)(atom("Good day")))
        "said('Good day')"
        """
        return self.logic.show(term)

    def brief(self, term: Term) -> str:
        """Return a term as text for messages; a long term is shortened.

        >>> len(Engine().brief(make_list(range(10000)))) < 1000
        True
        """
        return self.logic.brief(term)

    # ---- introspection -------------------------------------------------------------------------------

    @property
    def operators(self) -> Operators:
        """The operators for reading and writing texts; a program may add operators.

        >>> engine = Engine()
        >>> engine.call("op(700, xfx, near)"), "near" in engine.operators
        (True, True)
        """
        return self.logic.operators

    def output_topics(self) -> List[str]:
        """Return the topics of all subscriptions, sorted.

        >>> engine = Engine()
        >>> engine.load(goals="subscribe(fire, [], _, alarms, a)")
        >>> engine.output_topics()
        ['alarms']
        """
        return sorted({topic for topic, _ in self.knowledge.subscriptions})

    def loaded_deployments(self) -> Dict[str, Deployment]:
        """Return what each loaded folder has created, by the real path of the folder.

        A reload replaces the object of its folder.

        >>> engine = Engine()
        >>> engine.load_program(folder)
        >>> [len(deployment.rules) for deployment in engine.loaded_deployments().values()]
        [0]
        """
        return dict(self.deployments)

    def summary(self) -> str:
        """Return the number of rules, memories and subscriptions as text.

        >>> Engine().summary()
        '0 event rules, 0 memories, 0 subscriptions'
        """
        return (
            f"{format_count(len(self.rules.rules), 'event rule')}, "
            f"{format_count(len(list(self.knowledge.memories)), 'memory', 'memories')}, "
            f"{format_count(len(list(self.knowledge.subscriptions)), 'subscription')}"
        )

    def warnings(
        self,
        folder: Path,
        definitions: Definitions,
        topics: Optional[Topics] = None,
        direct: Iterable[TopicType] = (),
        find_refusal: Callable[[str], str] = lambda name: "",
    ) -> Iterator[RetalisError]:
        """Yield warnings about likely mistakes in the program.

        >>> engine = Engine()
        >>> engine.load(rules="alarm <- fire where prev(fires, _, 1, 2, _). fire <- fire.")
        >>> [warning.message.partition(":")[0] for warning in engine.warnings(folder, Definitions())][-1]
        'fire/0 fires itself, at once and without end'

        Args:
            folder: folder of the program.
            definitions: known message types.
            topics: topics of the program; by default none.
            direct: further topics whose messages become events.
            find_refusal: returns the reason why goals may not call a service, or "".
        """
        topics = self.input_topics.merge_with(Topics() if topics is None else topics)
        program = ProgramModel(
            self.rules,
            self.knowledge,
            definitions.with_strings(self.strings),
            topics,
            tuple(direct),
            folder,
            self._has_event_callbacks,
            find_refusal=find_refusal,
        )
        findings = run_checks(program, not self._incomplete_folders)
        return (finding.problem for finding in findings if finding.severity != INFO)

    @property
    def strings(self) -> str:
        """Form of strings in messages: ``"quoted"`` or ``"plain"``; see `Settings`.

        >>> Engine().strings
        'quoted'
        """
        return self._parts.slots.strings

    def status(self, most: int = DEFAULT_LISTING_LIMIT) -> Status:
        """Return the activity and contents of the engine, without waiting for it.

        If the engine is busy, ``work`` describes the current call and its duration.

        >>> engine = Engine()
        >>> engine.load(rules="alarm <- fire.", goals="memorize(alarm, [], _, alarms, 10)")
        >>> engine.event("fire", 1)
        >>> status = engine.status()
        >>> status.taken, status.rules[0].fired, status.memories[0].records, status.work
        (1, 1, 1, None)

        Args:
            most: limit for the listed rules, memories, subscriptions and queries; ``left_out`` counts the others.
        """
        return self._status_reader.read(most)

    @property
    def dropped(self) -> int:
        """Number of events that were dropped because the queue was full.

        >>> Engine().dropped
        0
        """
        return self.executor.dropped

    @property
    def far_ahead_count(self) -> int:
        """Number of events whose times were too far ahead of the clock.

        >>> Engine().far_ahead_count
        0
        """
        return self.event_input.far_ahead_count

    # ---- memories and subscriptions ----

    def has_memory(self, name: Term) -> bool:
        """Return whether a memory with an id exists.

        >>> engine = Engine()
        >>> engine.load(goals="memorize(fire, [], _, fires, 10)")
        >>> engine.has_memory(atom("fires"))
        True
        """
        return self.knowledge.memories.find(name) is not None

    def add_memory(
        self, event: Term, conditions: Sequence[Term], record: Term, name: Term, size: Term
    ) -> None:
        """Add a memory as goal ``memorize/5`` does, with the same limits and the same events that report it.

        >>> engine = Engine()
        >>> engine.add_memory(atom("fire"), [], atom("fire"), atom("fires"), 10)
        >>> engine.has_memory(atom("fires"))
        True

        Args:
            event: pattern of the events to store.
            conditions: goals that share variables with the pattern.
            record: term to store for an event; a variable stores the event itself.
            name: id of the memory.
            size: maximum number of records.

        Raises:
            PrologError: if the id exists or an argument is invalid.
        """
        self._call_or_raise((MEMORIZE, event, make_list(conditions), record, name, size))

    def delete_memory(self, name: Term) -> bool:
        """Delete a memory as goal ``delete_memory/1`` does; return whether it existed.

        >>> Engine().delete_memory(atom("fires"))
        False
        """

        # Both steps in one exclusive call: no other thread can delete the memory between them.
        def delete() -> bool:
            existed = self.has_memory(name)
            if existed:
                self._call_or_raise((DELETE_MEMORY, name))
            return existed

        return self.do(delete)

    def has_subscription(self, topic: Term, name: Term) -> bool:
        """Return whether a subscription with a topic and an id exists.

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
            event: pattern of the events to send.
            conditions: goals that share variables with the pattern.
            form: term to send for an event; a variable sends the event itself.
            topic: name of the topic.
            name: id of the subscription, unique for the topic.

        Raises:
            PrologError: if the subscription exists or an argument is invalid.
        """
        self._call_or_raise((SUBSCRIBE, event, make_list(conditions), form, topic, name))

    def delete_subscription(self, topic: Term, name: Term) -> bool:
        """Delete a subscription; return whether it existed.

        >>> Engine().delete_subscription(atom("alarms"), atom("a"))
        False
        """
        return self.do(lambda: self.knowledge.subscriptions.delete(topic, name))

    # ---- state ----

    def snapshot(self) -> bytes:
        """Return the complete state of the engine as bytes; see docs/reference/state-files.md.

        >>> engine = Engine()
        >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).")
        >>> engine.event("smoke(kitchen)", 1)
        >>> other = Engine.restore(engine.snapshot())
        >>> other.on_event(lambda term, start, end: print(other.show(term), end))
        >>> other.event("heat(kitchen)", 2)
        heat(kitchen) 2000000000
        alarm(kitchen) 2000000000

        Raises:
            UsageError: if a goal or callback of this engine calls this method.
        """

        def encode() -> Dict[str, bytes]:
            # The state is encoded within the exclusive call, because the variables of rules may be bound to other
            # values as soon as the engine continues.
            engine_snapshot = self.incremental_snapshot()
            return encode_state(engine_snapshot.capture(), engine_snapshot.encode_records())

        return pack_sections(self.do(encode))

    def incremental_snapshot(self) -> EngineSnapshot:
        """Return a reader of the state for consecutive snapshots, which omit a program that has not changed.

        >>> sorted(Engine().incremental_snapshot().capture())
        ['clauses', 'matches', 'program', 'run', 'values']
        """
        return self._parts.create_snapshot()

    @classmethod
    def restore(
        cls: Type[EngineType],
        data: bytes,
        clock: Optional[Clock] = None,
        settings: Optional[Settings] = None,
        reports: Optional[Reports] = None,
        definitions: Optional[Definitions] = None,
        foreign: Tuple[object, ...] = (),
        folder: Optional[Path] = None,
    ) -> EngineType:
        """Create an engine from the result of `snapshot`.

        The new engine has the program, memories, partial matches, pending queries, alarms and counters. Callbacks
        must be registered again, because they are not part of the program.

        >>> engine = Engine()
        >>> engine.load(goals="memorize(fire(_), [], _, fires, 10)")
        >>> engine.event("fire(hall)", 1)
        >>> Engine.restore(engine.snapshot()).query("memory_size(fires, N), memory_counter(fires, C)")
        [{'N': 10, 'C': 1}]

        Args:
            data: a result of `snapshot`.
            clock: as for a new engine; by default a clock that continues at the time of the snapshot.
            settings: as for a new engine; they are not part of the state.
            reports: as for a new engine.
            definitions: as for a new engine.
            foreign: the arguments that `add_foreign` was called with.
            folder: folder of the program; Python modules that the program has loaded are loaded again from there.

        Raises:
            UsageError: if the data is not a snapshot, is damaged, or has another format version.
        """
        file = convert_errors(lambda: unpack_sections(data))
        sections = convert_errors(lambda: decode_sections(file.sections))
        changes = changes_since(file.format_number)

        def create() -> EngineType:
            engine = cls(clock or create_clock(sections["run"]), settings, reports, definitions)
            if foreign:
                engine.add_foreign(*foreign)
            records = [
                [decode_records(from_bytes(data), ReadContext(changes=changes))]
                for name, data in file.sections.items()
                if name.startswith("memory ")
            ]
            snapshot = engine.incremental_snapshot()
            engine.executor.call(lambda: snapshot.restore(sections, records, folder, changes))
            return engine

        return convert_errors(create)

    def add_foreign(self, *sources: object) -> List[Functor]:
        """Define decorated Python functions, or all decorated functions of modules, as predicates (see `foreign`).

        >>> @foreign
        ... def half(number: int) -> float:
        ...     return number / 2
        >>> Engine().add_foreign(half)
        [functor('half', 2)]

        Returns:
            The functors of the new predicates.

        Raises:
            UsageError: if a function is not decorated, or a module has no decorated function.
            PrologError: if a system predicate has the same name.
        """
        functors = self.executor.call(lambda: define_foreign(self.logic, self.executor, *sources))
        self._foreign_sources.append(sources)
        return functors

    # ---- implementation ----

    def _check_and_dispatch(self, term: Term, start: Optional[int], end: Optional[int]) -> None:
        """Process an event that is not a message of a topic.

        Raises:
            UsageError: if it does not match its declaration.
        """
        declared = self.rules.declared_events
        refusal_reason = declared.refusal(term) if declared.checks_events else ""
        if refusal_reason:
            raise UsageError(f"event refused: {refusal_reason}")
        self._dispatch_event(term, start, end)

    def _parse_term(self, term: Union[str, Term], flags: ReadFlags = TERM_FLAGS) -> Term:
        return read_term(term, self.logic.operators, "text", flags).term if isinstance(term, str) else term

    def _collect_solutions(
        self, term: Term, names: Dict[str, Var], most: Optional[int]
    ) -> List[Dict[str, Term]]:
        """Return the first ``most`` solutions of a goal as copies, or all."""
        results: List[Dict[str, Term]] = []
        with closing(self.logic.solutions(term)) as solutions:
            # `islice` asks for no solution beyond the last one that is wanted.
            for _ in islice(solutions, most):
                # Values are copied before the next solution undoes their bindings. The dictionary keeps a variable
                # that occurs in two values one variable. The copies count against the memory limit of the goal.
                shared: Dict[Var, Term] = {}
                with self.logic.machine.budget.checking_long_steps():
                    results.append({name: copy(value, shared) for name, value in names.items()})
        return results

    def _call_or_raise(self, goal: Term) -> None:
        """Call a goal that must succeed."""
        if not self.executor.call(lambda: self._parts.goals.call_restoring_context(goal), (goal,)):
            raise UsageError(f"{self.logic.brief(goal)} fails")
