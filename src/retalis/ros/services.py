"""The six services: texts in, ``ok`` or ``error: ...`` out.

The services that change rules: ``~add_rule`` and ``~delete_rule``.

Service ``~list``: what a node holds, with counters.

The services that answer questions: ``~query`` and ``~explain``.

Service ``~reload``: the program's folder read again while the node runs.
"""

import os
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import rospy

from ..engine.engine import Engine
from ..engine.engine_status import MemoryStatus, RuleStatus, Status, SubscriptionStatus, WaitingStatus
from ..engine.external_queries import add_rule, ask, await_memories, delete_rule, do_for_others
from ..engine.runtime.problem_reports import Reports
from ..events.language.window_parser import subscribed_event
from ..events.program.program_folder import TOPICS, Topics, read_topics, topic_type
from ..explanation.explain import explain, records_origins
from ..foundation.errors import ProgramErrors, RetalisError, SyntaxFault, UsageError, beginning, printable
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import Limits, checked_number
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.terms.list_terms import conjuncts, make_list
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import COMMA, TRUE, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .internal_topics import TextOnly, resolve
from .ros_interface import RosInterface
from .ros_log import log_counts
from .topic_statistics import InputStatus, published_types

OK = "ok"

MAX_ANSWER_CHARACTERS = 1000
"""Characters of what a service says is wrong."""


MAX_REQUEST_CHARACTERS = 100_000
"""Characters of a request's fields together: the engine takes no events while they are read, for 0.5 to 1 s."""

_SUBSCRIBE = functor("subscribe", 5)


def shown(text: str) -> str:
    """Return the field of a request as answers show it."""
    return printable(beginning(text.strip()))


def provide(name: str, kind: Any, handler: Callable[[Any], Any]) -> None:
    """Provide a service whose requests have texts of a bounded length.

    Args:
        name: the service.
        kind: its class; the first field of its response is the result.
        handler: takes a request and returns its response.
    """

    def handle(request: Any) -> Any:
        size = sum(len(value) for value in _texts(request))
        if size > MAX_REQUEST_CHARACTERS:
            most = MAX_REQUEST_CHARACTERS
            return {"result": f"error: the request has {size} characters: expected at most {most}"}
        return handler(request)

    rospy.Service(name, kind, handle)


def _texts(request: Any) -> Iterator[str]:
    for field in request.__slots__:
        value = getattr(request, field)
        if isinstance(value, str):
            yield value
        elif isinstance(value, list):
            yield from value


def answer(work: Callable[[], None]) -> str:
    """Do a request; return ``ok``, or ``error: `` and the reason in one line with the position in the text."""
    try:
        work()
    except RetalisError as error:
        return reason(error)
    return OK


def reason(error: RetalisError) -> str:
    """Return an error as services answer it."""
    return "error: " + " ".join(
        beginning(error.brief(), MAX_ANSWER_CHARACTERS).splitlines()
    )  # names may have line breaks


class _Fields(NamedTuple):
    """What requests for a memory and for a subscription have in common.

    Attributes:
        event: the pattern of events.
        conditions: goals.
        form: what is made of an event; a variable for the event itself.
        free: the names in the format to which nothing gives a value.
    """

    event: Term
    conditions: List[Term]
    form: Term
    free: List[str]


class EngineServices:
    """The services of node retalis: subscriptions and memories.

    Args:
        engine: whose they are.
        text_only: is told of the topics that are subscribed.
        doubt: says why events of a pattern will hardly come, "" where they may.
        misfit: says why no output of a subscription, a goal ``subscribe/5``, can be a message of the type of its
            topic; "" if some may be.
    """

    def __init__(
        self,
        engine: Engine,
        text_only: TextOnly,
        doubt: Callable[[Term], str],
        misfit: Callable[[CompoundTerm, str], str],
    ):
        from .. import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._text_only = text_only
        self._doubt = doubt
        self._misfit = misfit
        provide("add_output_subscription", srv.AddOutputSubscription, self._add_subscription)
        provide("delete_output_subscription", srv.DeleteOutputSubscription, self._delete_subscription)
        provide("add_memory", srv.AddMemory, self._add_memory)
        provide("delete_memory", srv.DeleteMemory, self._delete_memory)

    def _add_subscription(self, request: Any) -> str:
        def work() -> None:
            topic, key = name(request.topic, "topic"), name(request.id, "id")
            if self._engine.has_subscription(topic, key):
                raise UsageError(
                    f"a subscription {shown(request.id)} of topic {shown(request.topic)} already exists"
                )
            fields = self._fields(request)
            goal = (_SUBSCRIBE, fields.event, make_list(fields.conditions), fields.form, topic, key)
            misfit = self._misfit(goal, request.topic.strip())
            if misfit:
                raise UsageError(f"format: {misfit}")
            self._engine.add_subscription(fields.event, fields.conditions, fields.form, topic, key)
            self._warn_of_free("subscribe", request.id, fields)
            taken = fields._replace(event=subscribed_event(fields.event))
            self._warn_of_silence("subscribe", request.id, taken)
            self._text_only.look(request.topic.strip())

        return answer(lambda: do_for_others(self._engine, work))

    def _add_memory(self, request: Any) -> str:
        def work() -> None:
            key, size = name(request.id, "id"), self._size(request.size)
            if self._engine.has_memory(key):
                raise UsageError(f"a memory {shown(request.id)} already exists")
            fields = self._fields(request)
            self._engine.add_memory(fields.event, fields.conditions, fields.form, key, size)
            self._warn_of_free("memorize", request.id, fields)
            self._warn_of_silence("memorize", request.id, fields)

        return answer(lambda: do_for_others(self._engine, work))

    def _delete_subscription(self, request: Any) -> str:
        def work() -> None:
            topic, key = name(request.topic, "topic"), name(request.id, "id")
            if not self._engine.delete_subscription(topic, key):
                raise UsageError(
                    f"there is no subscription {shown(request.id)} of topic {shown(request.topic)}"
                )

        return answer(work)

    def _delete_memory(self, request: Any) -> str:
        def work() -> None:
            if not self._engine.delete_memory(name(request.id, "id")):
                raise UsageError(f"there is no memory {shown(request.id)}")

        return answer(work)

    def _fields(self, request: Any) -> _Fields:
        fields = {"event": request.event, "conditions": request.conditions.strip() or "true"}
        (event, conditions, form), names = self._read_together({**fields, "format": request.format})
        goals = [] if conditions is TRUE else list(conjuncts(conditions))
        self._check("event", "an event: an atom or a compound term", event, (Atom, tuple, Var))
        for one in goals:
            self._check("conditions", "goals: atoms or compound terms", one, (Atom, tuple))
        self._check("format", "an atom or a compound term, or _ for the event", form, (Atom, tuple, Var))
        unbound = set(variables(form)).difference(variables((COMMA, event, conditions)))
        free = [name for name, var in names.items() if var in unbound]
        return _Fields(event, goals, form, [] if isinstance(form, Var) else free)

    def _warn_of_free(self, goal: str, text: str, fields: _Fields) -> None:
        """Say where the format has variables that will never have a value."""
        if fields.free:
            rospy.logwarn(
                "%s %s: nothing in event or conditions gives %s in the format a value",
                goal,
                shown(text),
                " and ".join(fields.free),
            )

    def _warn_of_silence(self, goal: str, text: str, fields: _Fields) -> None:
        """Say where nothing makes the events that are waited for."""
        doubt = self._doubt(fields.event)
        if doubt:
            rospy.logwarn("%s %s: %s", goal, shown(text), printable(doubt))

    def _check(self, field: str, expected: str, term: Term, kinds: Tuple[type, ...]) -> None:
        if not isinstance(deref(term), kinds):
            raise UsageError(f"{field}: expected {expected}, found {self._engine.brief(term)}")

    def _read_together(self, fields: Dict[str, str]) -> Tuple[List[Term], Dict[str, Var]]:
        """Read fields each by itself, and have variables of one name be the same in all of them."""
        shared: Dict[str, Var] = {}
        terms: List[Term] = []
        for field, text in fields.items():
            if not text.strip():
                raise UsageError(f"{field} is empty")
            try:
                flags = ReadFlags(made=field == "format")
                read = read_term(text, self._engine.operators, field, flags)
            except SyntaxFault as fault:
                raise UsageError(f"{field}: {fault.brief()}") from fault
            for name, var in read.names.items():
                known = shared.setdefault(name, var)
                if known is not var:
                    var.ref = known
            terms.append(read.term)
        return terms, shared

    def _size(self, text: str) -> int:
        try:
            size = int(text)
        except ValueError:
            raise UsageError(f'size: expected a whole number, found "{beginning(text)}"') from None
        if size < 0:
            raise UsageError(f"size: expected a whole number of 0 or more, found {size}")
        return size


class InterfaceServices:
    """The services of the ROS interface: input subscriptions."""

    def __init__(self, interface: RosInterface):
        from .. import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._interface = interface
        provide("add_input_subscription", srv.AddInputSubscription, self._add)
        provide("delete_input_subscription", srv.DeleteInputSubscription, self._delete)

    def _add(self, request: Any) -> str:
        topic, kind = request.topic.strip(), request.message_type.strip()

        def work() -> None:
            topic_type(topic, kind)  # names that ROS does not allow are refused before any is looked up
            known = self._interface.outputs.knows(kind)
            meant = "" if known else Definitions().misspelt(kind)
            # A publisher brings the definition of its type, so that a type which is not installed is no mistake.
            if meant and not _is_published(topic, kind):
                raise UsageError(
                    f"message_type: there is no type '{shown(kind)}' here; did you mean {meant}? If a publisher is "
                    "to bring the type, start the publisher first"
                )
            self._interface.subscribe(topic, kind)
            if not known:
                rospy.logwarn(
                    "topic %s is subscribed as %s, which is not known here: it is learned from a publisher",
                    shown(topic),
                    kind,
                )

        return answer(work)

    def _delete(self, request: Any) -> str:
        return answer(lambda: self._interface.unsubscribe(request.topic.strip()))


def _is_published(topic: str, kind: str) -> bool:
    """Return whether somebody publishes a topic as a type, as far as the master knows."""
    return published_types().get(resolve(topic)) == kind


def name(text: str, field: str) -> Term:
    """Return the term of a topic or an id: what the text reads as if that is a constant, else the text's atom.

    A topic like ``robot/marker1`` reads as a division, but is meant as a name.
    """
    text = text.strip()
    if not text:
        raise UsageError(f"{field} is empty")
    try:
        term = read_term(text, Operators.prolog(), field).term
    except SyntaxFault:
        return atom(text)
    return term if isinstance(term, (Atom, int)) else atom(text)


class RuleServices:
    """Services ``~add_rule`` and ``~delete_rule`` of node retalis.

    Args:
        engine: whose rules they change.
    """

    def __init__(self, engine: Engine):
        from .. import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._added = srv.AddRuleResponse
        provide("~add_rule", srv.AddRule, self._add)
        provide("~delete_rule", srv.DeleteRule, self._delete)

    def _add(self, request: Any) -> Any:
        try:
            return self._added(OK, add_rule(self._engine, request.rule, request.label))
        except (SyntaxFault, ProgramErrors) as error:
            return self._added(
                f"error: {beginning(str(error), MAX_ANSWER_CHARACTERS)}", ""
            )  # with the lines and carets
        except RetalisError as error:
            return self._added(reason(error), "")

    def _delete(self, request: Any) -> str:
        return answer(lambda: delete_rule(self._engine, request.label))


DEFAULT_LISTED_ITEMS = 100
"""How many of each kind are listed where a request does not say it."""

MAX_LISTED_ITEMS = 10_000
"""How many of each kind are listed, whatever a request says."""

NEVER = -1
"""Nanoseconds of a duration that is none."""

_LAST = 1 << 32
"""Seconds after the last that a message of ROS can tell."""

_MAX_INT32 = 1 << 31


class ListService:
    """Service ``~list`` of a node.

    Args:
        inputs: gives what has come on its subscribed topics.
        status: gives the status of its engine with at most so many of each kind; None where it has no engine.
        reports: the problems of a node that has no engine.
    """

    def __init__(
        self,
        inputs: Callable[[], Sequence[InputStatus]],
        status: Optional[Callable[[int], Status]] = None,
        reports: Optional[Reports] = None,
    ):
        from .. import msg, srv  # noqa: PLC0415 - generated: there only where the package was built

        self._inputs = inputs
        self._status = status
        self._reports = reports
        self._msg = msg
        self._response = srv.ListResponse
        rospy.Service("~list", srv.List, self._list)

    def _list(self, request: Any) -> Any:
        most = min(request.most or DEFAULT_LISTED_ITEMS, MAX_LISTED_ITEMS)
        response = self._response(result=OK)
        inputs = self._inputs()
        response.inputs = [self._input(one) for one in inputs[:most]]
        response.more_inputs = max(0, len(inputs) - most)
        if self._status is None:
            response.now = rospy.get_rostime()
            if self._reports is not None:
                response.errors, response.warnings = self._reports.errors, self._reports.warnings
        else:
            self._fill(response, self._status(most))
        response.errors += log_counts.errors
        response.warnings += log_counts.warnings
        return response

    def _fill(self, response: Any, status: Status) -> None:
        response.now = _time(status.now)
        if status.work is not None:
            response.work, response.work_goal = status.work.what, status.work.goal
            response.work_place = status.work.place
            response.work_time = _duration(int(status.work.seconds * SECOND))
        for name in ("taken", "fired", "queued", "dropped", "errors", "warnings", "alarms"):
            setattr(response, name, getattr(status, name))
        response.rules = [self._rule(one) for one in status.rules]
        response.memories = [self._memory(one) for one in status.memories]
        response.subscriptions = [self._subscription(one) for one in status.subscriptions]
        response.waiting = [self._query(one) for one in status.waiting]
        for name, number in status.left_out._asdict().items():
            setattr(response, f"more_{name}", number)

    def _rule(self, one: RuleStatus) -> Any:
        return self._msg.RuleStatus(**one._replace(last_fired=_time(one.last_fired))._asdict())

    def _memory(self, one: MemoryStatus) -> Any:
        return self._msg.MemoryStatus(
            **one._replace(oldest=_time(one.oldest), newest=_time(one.newest))._asdict()
        )

    def _subscription(self, one: SubscriptionStatus) -> Any:
        return self._msg.SubscriptionStatus(**one._asdict())

    def _query(self, one: WaitingStatus) -> Any:
        memories = [
            self._msg.AwaitedMemory(memory.id, _time(memory.instant), _duration(memory.behind))
            for memory in one.memories
        ]
        return self._msg.WaitingStatus(one.event, _time(one.since), memories, one.left_out)

    def _input(self, one: InputStatus) -> Any:
        age = None if one.age is None else int(one.age * SECOND)
        return self._msg.InputStatus(
            **one._replace(age=_duration(age), lag=_duration(one.lag or 0))._asdict()
        )


def _time(instant: Optional[int]) -> Any:
    """Return an instant as ROS has it; zero for none, the first or last one for those that it cannot tell."""
    return rospy.Time(0, min(max(instant or 0, 0), _LAST * SECOND - 1))


def _duration(nanoseconds: Optional[int]) -> Any:
    """Return a time span as ROS has it; the shortest negative one for none."""
    span = NEVER if nanoseconds is None else nanoseconds
    return rospy.Duration(0, min(max(span, -_MAX_INT32 * SECOND), _MAX_INT32 * SECOND - 1))


DEFAULT_MAX_SOLUTIONS = 100
"""Solutions of a query that does not say how many."""

MAX_SOLUTIONS = 100_000
"""Solutions of a query, whatever it says."""

DEFAULT_QUERY_WAIT_SECONDS = 10.0
"""Seconds that a query waits for memories where it does not say how long."""

AT_ONCE = 50
"""Queries that may wait for memories at once: each holds a thread and a connection."""

MAX_EXPLANATION_LINE_CHARACTERS = MAX_ANSWER_CHARACTERS
"""Characters of a line of an explanation."""

EXPLAINING = 2.0
"""Seconds in which an explanation has to be found: no event is taken meanwhile."""

MAX_EXPLANATION_LINES = 1_000
"""Lines of an explanation."""

NOT_RECORDED = (
    "what events come from is not recorded: "
    "start the node with ~explain (explain:=true with roslaunch), or call set_etalis_flag(etalis_justification, on)"
)


class QueryServices:
    """Services ``~query`` and ``~explain`` of node retalis.

    Args:
        engine: answers.
    """

    def __init__(self, engine: Engine):
        from .. import msg, srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._msg, self._srv = msg, srv
        self._waiting = BoundedSemaphore(AT_ONCE)
        provide("~query", srv.Query, self._query)
        provide("~explain", srv.Explain, self._explain)

    def _query(self, request: Any) -> Any:
        response = self._srv.QueryResponse
        try:
            seconds = checked_number("seconds", request.seconds, float)
            limits = Limits(seconds or None, request.inferences or None, output_megabytes=None)
            most = min(request.max_solutions or DEFAULT_MAX_SOLUTIONS, MAX_SOLUTIONS)
            if request.wait_for:
                self._await(request)
            found = ask(self._engine, request.goal, most, limits)
        except SyntaxFault as fault:
            return response(f"error: goal: {fault.brief()}", False, [])
        except RetalisError as error:
            return response(reason(error), False, [])
        solutions = [
            self._msg.Solution([self._msg.Binding(*value) for value in solution])
            for solution in found.solutions
        ]
        return response(OK, found.complete, solutions)

    def _await(self, request: Any) -> None:
        names = [name(text, "wait_for") for text in request.wait_for]
        seconds = checked_number("timeout", request.timeout, float) or DEFAULT_QUERY_WAIT_SECONDS
        if not self._waiting.acquire(blocking=False):
            raise UsageError(f"{AT_ONCE} queries wait already")
        try:
            await_memories(self._engine, names, request.stamp.to_nsec(), seconds)
        finally:
            self._waiting.release()

    def _explain(self, request: Any) -> Any:
        response = self._srv.ExplainResponse
        if not records_origins(self._engine):
            return response(f"error: {NOT_RECORDED}", False, [])
        try:
            found = explain(self._engine, request.event, EXPLAINING)
        except RetalisError as error:
            return response(reason(error), False, [])
        lines: List[str] = []
        for tree in found.lines:
            lines += tree.indented()
            if len(lines) > MAX_EXPLANATION_LINES:
                lines = [*lines[:MAX_EXPLANATION_LINES], "..."]
                break
        return response(OK, found.happened, [line[:MAX_EXPLANATION_LINE_CHARACTERS] for line in lines])


MAX_RELOAD_ERROR_CHARACTERS = 10_000
"""Characters of what an answer says is wrong."""

RESTART = f"topics: {TOPICS} has changed; its topics change when the node is started again"


class ReloadService:
    """Service ``~reload`` of node retalis.

    Args:
        engine: whose program it is.
        folder: the program's.
        writable: where goals may write files; None means anywhere.
        topics: of the program when the node started.
        loaded: called where the program has been read again.
    """

    def __init__(
        self,
        engine: Engine,
        folder: Path,
        writable: Optional[Tuple[str, ...]],
        topics: Topics,
        loaded: Callable[[Topics], None],
    ):
        from .. import srv  # noqa: PLC0415 - generated: there only where the package was built

        self._engine = engine
        self._folder = folder
        self._writable = writable
        self._topics = topics
        self._loaded = loaded
        self._reloaded = srv.ReloadResponse
        rospy.Service("~reload", srv.Reload, self._reload)

    def _reload(self, request: Any) -> Any:
        try:
            check_writers(self._folder, self._writable)
            topics = topics_now(self._folder)
            changes = self._engine.reload(self._folder)
        except RetalisError as error:
            return self._reloaded(
                f"error: {beginning(str(error), MAX_RELOAD_ERROR_CHARACTERS)}", []
            )  # with the lines and carets
        if topics != self._topics:
            changes.append(RESTART)
        self._loaded(topics)
        rospy.loginfo("%s was read again: %s", self._folder, self._engine.summary())
        return self._reloaded(OK, changes)


def check_writers(folder: Path, writable: Optional[Tuple[str, ...]]) -> None:
    """Accept a program's folder in which no goal may write: its goals and rules may more than those of services.

    Raises:
        UsageError: where a goal may.
    """
    real = os.path.realpath(folder)
    for other in ("/",) if writable is None else writable:
        above = os.path.realpath(other)
        if os.path.commonpath((real, above)) == above:
            raise UsageError(
                f"{folder} is in {other} of ~write_folders: goals of services could write the program; "
                "restart the node to have it read again"
            )


def topics_now(folder: Path) -> Topics:
    """Return the topics of a program; none where there is no file of them, as when the node starts.

    Raises:
        ProgramErrors: what is wrong in the file.
    """
    try:
        return read_topics(folder / TOPICS)
    except UsageError:
        return Topics()
