"""ROS services of the nodes.

* `EngineServices`: subscriptions and memories; `InterfaceServices`: subscriptions of input topics;
* `RuleServices`: ``~add_rule`` and ``~delete_rule``;
* `ListService`: ``~list``, the contents of a node with counters;
* `QueryServices`: ``~query`` and ``~explain``;
* `ReloadService`: ``~reload``, which reads the program's folder again.

The first field of each response is ``ok``, or ``error: `` with the reason. A handler runs in a thread of rospy and
hands its work to the engine, which executes it between two events.
"""

import os
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple, Union

import rospy

from ..engine.client_requests import add_rule, ask, delete_rule, run_restricted, wait_for_memories
from ..engine.engine import Engine
from ..engine.engine_status import MemoryStatus, RuleStatus, Status, SubscriptionStatus, WaitingStatus
from ..engine.runtime.problem_reports import Reports
from ..events.language.stream_parser import subscription_event
from ..events.program.topic_configuration import TOPICS, Topics, read_topics, topic_type
from ..explanation.event_explanations import explain, records_origins
from ..foundation.errors import ProgramErrors, RetalisError, SyntaxFault, UsageError, printable, shorten
from ..foundation.ros_names import topic_fault
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import Limits, validate_limit
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.terms.list_terms import conjuncts, make_list
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import COMMA, TRUE, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .installed_message_classes import installed_types
from .internode_topics import InputTopicChanges, resolve
from .ros_interface import RosInterface, UntypedTopicWarnings
from .ros_log import log_counts
from .topic_statistics import InputStatus, published_types

OK = "ok"

MAX_ANSWER_CHARACTERS = 1000
"""Limit for the reason in a response."""


MAX_REQUEST_CHARACTERS = 100_000
"""Limit for the fields of a request together. The engine processes no events while they are parsed: 0.5 to 1 s."""

MAX_MEMORY_SIZE = 1_000_000
"""Limit for the records of a memory that a request adds."""

_SUBSCRIBE = functor("subscribe", 5)


def quote_text(text: str) -> str:
    """Return the field of a request in the form in which responses quote it."""
    return printable(shorten(text.strip()))


def offer_service(name: str, service_class: Any, handler: Callable[[Any], Any]) -> None:
    """Offer a service whose requests have a limited number of characters.

    Args:
        name: name of the service.
        service_class: class of the service; the first field of its response is the result.
        handler: returns the response to a request.
    """

    def handle(request: Any) -> Any:
        size = sum(len(value) for value in _iterate_texts(request))
        if size > MAX_REQUEST_CHARACTERS:
            limit = MAX_REQUEST_CHARACTERS
            return {"result": f"error: the request has {size} characters: expected at most {limit}"}
        return handler(request)

    rospy.Service(name, service_class, handle)


def _iterate_texts(request: Any) -> Iterator[str]:
    for field in request.__slots__:
        value = getattr(request, field)
        if isinstance(value, str):
            yield value
        elif isinstance(value, list):
            yield from value


def execute_request(execute: Callable[[], None]) -> str:
    """Execute a request; return ``ok``, or ``error: `` and the reason in one line with the position in the text."""
    try:
        execute()
    except RetalisError as error:
        return format_error(error)
    return OK


def format_error(error: RetalisError) -> str:
    """Return the result of a request that failed with an error."""
    # In one line: quoted names may contain line breaks.
    return "error: " + " ".join(shorten(error.brief(), MAX_ANSWER_CHARACTERS).splitlines())


class _Fields(NamedTuple):
    """The common fields of requests for a memory and for a subscription.

    Attributes:
        event: pattern of events.
        conditions: goals.
        template: template of the result; a variable stands for the event itself.
        unbound_names: names of variables in the template that occur neither in the pattern nor in the goals.
    """

    event: Term
    conditions: List[Term]
    template: Term
    unbound_names: List[str]


class EngineServices:
    """The services of node retalis: subscriptions and memories.

    Args:
        engine: engine of the node.
        untyped_topics: warns about subscribed topics without a type.
        explain_missing_source: returns the reason why no events of a pattern are expected; "" if there may be some.
        explain_type_mismatch: returns the reason why no output of a subscription, a goal ``subscribe/5``, can be a
            message of its topic's type; "" if some may be.
    """

    def __init__(
        self,
        engine: Engine,
        untyped_topics: UntypedTopicWarnings,
        explain_missing_source: Callable[[Term], str],
        explain_type_mismatch: Callable[[CompoundTerm, str], str],
    ):
        from .. import srv  # noqa: PLC0415 - generated when the package is built

        self._engine = engine
        self._untyped_topics = untyped_topics
        self._explain_missing_source = explain_missing_source
        self._explain_type_mismatch = explain_type_mismatch
        offer_service("add_output_subscription", srv.AddOutputSubscription, self._add_subscription)
        offer_service("delete_output_subscription", srv.DeleteOutputSubscription, self._delete_subscription)
        offer_service("add_memory", srv.AddMemory, self._add_memory)
        offer_service("delete_memory", srv.DeleteMemory, self._delete_memory)

    def _add_subscription(self, request: Any) -> str:
        def execute() -> None:
            topic, key = parse_name(request.topic, "topic"), parse_name(request.id, "id")
            # No event could ever be published on such a topic.
            fault = topic_fault(request.topic.strip())
            if fault is not None:
                raise UsageError(f"topic: {fault}")
            if self._engine.has_subscription(topic, key):
                raise UsageError(
                    f"a subscription {quote_text(request.id)} of topic {quote_text(request.topic)} already exists"
                )
            fields = self._parse_request(request)
            goal = (_SUBSCRIBE, fields.event, make_list(fields.conditions), fields.template, topic, key)
            # Checked before the subscription is added: a response with an error must leave the engine unchanged.
            type_mismatch = self._explain_type_mismatch(goal, request.topic.strip())
            if type_mismatch:
                raise UsageError(f"format: {type_mismatch}")
            self._engine.add_subscription(fields.event, fields.conditions, fields.template, topic, key)
            self._log_unbound_variables("subscribe", request.id, fields)
            matched_fields = fields._replace(event=subscription_event(fields.event))
            self._log_missing_source("subscribe", request.id, matched_fields)
            self._untyped_topics.check(request.topic.strip())

        return execute_request(lambda: run_restricted(self._engine, execute))

    def _add_memory(self, request: Any) -> str:
        def execute() -> None:
            key, size = parse_name(request.id, "id"), self._parse_size(request.size)
            if self._engine.has_memory(key):
                raise UsageError(f"a memory {quote_text(request.id)} already exists")
            fields = self._parse_request(request)
            self._engine.add_memory(fields.event, fields.conditions, fields.template, key, size)
            self._log_unbound_variables("memorize", request.id, fields)
            self._log_missing_source("memorize", request.id, fields)

        return execute_request(lambda: run_restricted(self._engine, execute))

    def _delete_subscription(self, request: Any) -> str:
        def execute() -> None:
            topic, key = parse_name(request.topic, "topic"), parse_name(request.id, "id")
            if not self._engine.delete_subscription(topic, key):
                raise UsageError(
                    f"there is no subscription {quote_text(request.id)} of topic {quote_text(request.topic)}"
                )

        return execute_request(execute)

    def _delete_memory(self, request: Any) -> str:
        def execute() -> None:
            if not self._engine.delete_memory(parse_name(request.id, "id")):
                raise UsageError(f"there is no memory {quote_text(request.id)}")

        return execute_request(execute)

    def _parse_request(self, request: Any) -> _Fields:
        fields = {"event": request.event, "conditions": request.conditions.strip() or "true"}
        (event, conditions, template), names = self._parse_fields({**fields, "format": request.format})
        goals = [] if conditions is TRUE else list(conjuncts(conditions))
        self._require_type("event", "an event: an atom or a compound term", event, (Atom, tuple, Var))
        for goal in goals:
            self._require_type("conditions", "goals: atoms or compound terms", goal, (Atom, tuple))
        self._require_type(
            "format", "an atom or a compound term, or _ for the event", template, (Atom, tuple, Var)
        )
        unbound = set(variables(template)).difference(variables((COMMA, event, conditions)))
        unbound_names = [name for name, var in names.items() if var in unbound]
        return _Fields(event, goals, template, [] if isinstance(template, Var) else unbound_names)

    def _log_unbound_variables(self, goal: str, text: str, fields: _Fields) -> None:
        """Log the variables of the format that neither the pattern nor the conditions bind."""
        if fields.unbound_names:
            rospy.logwarn(
                "%s %s: nothing in event or conditions gives %s in the format a value",
                goal,
                quote_text(text),
                " and ".join(fields.unbound_names),
            )

    def _log_missing_source(self, goal: str, text: str, fields: _Fields) -> None:
        """Log the reason why no events of the pattern are expected, if there is one."""
        missing_source = self._explain_missing_source(fields.event)
        if missing_source:
            rospy.logwarn("%s %s: %s", goal, quote_text(text), printable(missing_source))

    def _require_type(self, field: str, expected: str, term: Term, types: Tuple[type, ...]) -> None:
        if not isinstance(deref(term), types):
            raise UsageError(f"{field}: expected {expected}, found {self._engine.brief(term)}")

    def _parse_fields(self, fields: Dict[str, str]) -> Tuple[List[Term], Dict[str, Var]]:
        """Parse each field; variables with the same name are shared by all fields."""
        shared: Dict[str, Var] = {}
        terms: List[Term] = []
        for field, text in fields.items():
            if not text.strip():
                raise UsageError(f"{field} is empty")
            try:
                # Separate parsing of the fields gives errors with positions within the field that the caller sent.
                flags = ReadFlags(is_constructed=field == "format")
                parsed = read_term(text, self._engine.operators, field, flags)
            except SyntaxFault as fault:
                raise UsageError(f"{field}: {fault.brief()}") from fault
            for name, var in parsed.names.items():
                known_var = shared.setdefault(name, var)
                if known_var is not var:
                    var.ref = known_var
            terms.append(parsed.term)
        return terms, shared

    def _parse_size(self, text: str) -> int:
        try:
            size = int(text)
        except ValueError:
            raise UsageError(f'size: expected a whole number, found "{shorten(text)}"') from None
        # A memory of size 0 would never store a record.
        if not 1 <= size <= MAX_MEMORY_SIZE:
            raise UsageError(
                f"size: expected a whole number from 1 to {MAX_MEMORY_SIZE}, found {shorten(text)}"
            )
        return size


class InterfaceServices:
    """The services of the ROS interface: subscriptions of input topics.

    Args:
        interface: the ROS interface; or the list of changes for node retalis, if that node subscribes itself.
    """

    def __init__(self, interface: Union[RosInterface, InputTopicChanges]):
        from .. import srv  # noqa: PLC0415 - generated when the package is built

        self._interface = interface
        offer_service("add_input_subscription", srv.AddInputSubscription, self._add)
        offer_service("delete_input_subscription", srv.DeleteInputSubscription, self._delete)

    def _add(self, request: Any) -> str:
        topic, message_type = request.topic.strip(), request.message_type.strip()

        def execute() -> None:
            # Rejects invalid names before any lookup.
            topic_type(topic, message_type)
            is_known = self._interface.knows_type(message_type)
            suggestion = "" if is_known else Definitions(installed_types()).misspelt(message_type)
            # An unknown type is not an error: a publisher's connection header contains its definition.
            if suggestion and not _is_published(topic, message_type):
                raise UsageError(
                    f"message_type: there is no type '{quote_text(message_type)}' here; did you mean {suggestion}? "
                    "If a publisher is to bring the type, start the publisher first"
                )
            self._interface.subscribe(topic, message_type)
            if not is_known:
                rospy.logwarn(
                    "topic %s is subscribed as %s, which is not known here: it is learned from a publisher",
                    quote_text(topic),
                    message_type,
                )

        return execute_request(execute)

    def _delete(self, request: Any) -> str:
        def execute() -> None:
            self._interface.unsubscribe(request.topic.strip())

        return execute_request(execute)


def _is_published(topic: str, message_type: str) -> bool:
    """Return whether the master knows a publisher of a topic with this type."""
    return published_types().get(resolve(topic)) == message_type


def parse_name(text: str, field: str) -> Term:
    """Return the term of a topic or an id: the parsed text if it is an atom or an integer, otherwise an atom.

    The parser reads a topic like ``robot/marker1`` as a division, but it is a name.
    """
    text = text.strip()
    if not text:
        raise UsageError(f"{field} is empty")
    try:
        # Standard operators, not the program's: the name of a topic must not depend on the operators of a program.
        term = read_term(text, Operators.prolog(), field).term
    except SyntaxFault:
        return atom(text)
    return term if isinstance(term, (Atom, int)) else atom(text)


class RuleServices:
    """Services ``~add_rule`` and ``~delete_rule`` of node retalis.

    Args:
        engine: engine of the node.
    """

    def __init__(self, engine: Engine):
        from .. import srv  # noqa: PLC0415 - generated when the package is built

        self._engine = engine
        self._response = srv.AddRuleResponse
        offer_service("~add_rule", srv.AddRule, self._add)
        offer_service("~delete_rule", srv.DeleteRule, self._delete)

    def _add(self, request: Any) -> Any:
        try:
            return self._response(OK, add_rule(self._engine, request.rule, request.label))
        except (SyntaxFault, ProgramErrors) as error:
            # In several lines: the source lines, with carets below the errors.
            return self._response(f"error: {shorten(str(error), MAX_ANSWER_CHARACTERS)}", "")
        except RetalisError as error:
            return self._response(format_error(error), "")

    def _delete(self, request: Any) -> str:
        return execute_request(lambda: delete_rule(self._engine, request.label))


DEFAULT_LISTED_ITEMS = 100
"""Default number of items that ``~list`` returns of each kind."""

MAX_LISTED_ITEMS = 10_000
"""Limit for the items that ``~list`` returns of each kind."""

NO_DURATION = -1
"""Duration in nanoseconds that represents an absent value."""

_TIME_LIMIT_SECONDS = 1 << 32
"""First second that a time in a ROS message cannot represent."""

_DURATION_LIMIT_SECONDS = 1 << 31
"""First second that a duration in a ROS message cannot represent."""


class ListService:
    """Service ``~list`` of a node.

    Args:
        inputs: returns the counters of the subscribed topics.
        status: returns the status of the engine with a limited number of items of each kind; None without an engine.
        reports: problem counts of a node without an engine.
    """

    def __init__(
        self,
        inputs: Callable[[], Sequence[InputStatus]],
        status: Optional[Callable[[int], Status]] = None,
        reports: Optional[Reports] = None,
    ):
        from .. import msg, srv  # noqa: PLC0415 - generated when the package is built

        self._get_inputs = inputs
        self._get_status = status
        self._reports = reports
        self._msg = msg
        self._response = srv.ListResponse
        rospy.Service("~list", srv.List, self._list)

    def _list(self, request: Any) -> Any:
        # Each kind is cut separately, and the response has the number of omitted items.
        limit = min(request.most or DEFAULT_LISTED_ITEMS, MAX_LISTED_ITEMS)
        response = self._response(result=OK)
        inputs = self._get_inputs()
        response.inputs = [self._to_input_message(status) for status in inputs[:limit]]
        response.more_inputs = max(0, len(inputs) - limit)
        if self._get_status is None:
            response.now = rospy.get_rostime()
            if self._reports is not None:
                response.errors, response.warnings = self._reports.errors, self._reports.warnings
        else:
            self._fill_engine_status(response, self._get_status(limit))
        # `Reports` counts the problems of events, and `log_counts` all other records of the log; see `ros_log`.
        response.errors += log_counts.errors
        response.warnings += log_counts.warnings
        return response

    def _fill_engine_status(self, response: Any, status: Status) -> None:
        response.now = _to_ros_time(status.now)
        if status.work is not None:
            response.work, response.work_goal = status.work.what, status.work.goal
            response.work_place = status.work.place
            response.work_time = _to_ros_duration(int(status.work.seconds * SECOND))
        for field in ("taken", "fired", "queued", "dropped", "errors", "warnings", "alarms"):
            setattr(response, field, getattr(status, field))
        response.rules = [self._to_rule_message(status) for status in status.rules]
        response.memories = [self._to_memory_message(status) for status in status.memories]
        response.subscriptions = [self._to_subscription_message(status) for status in status.subscriptions]
        response.waiting = [self._to_query_message(status) for status in status.waiting]
        for field, count in status.left_out._asdict().items():
            setattr(response, f"more_{field}", count)

    def _to_rule_message(self, rule: RuleStatus) -> Any:
        return self._msg.RuleStatus(**rule._replace(last_fired=_to_ros_time(rule.last_fired))._asdict())

    def _to_memory_message(self, memory: MemoryStatus) -> Any:
        return self._msg.MemoryStatus(
            **memory._replace(
                oldest=_to_ros_time(memory.oldest), newest=_to_ros_time(memory.newest)
            )._asdict()
        )

    def _to_subscription_message(self, subscription: SubscriptionStatus) -> Any:
        return self._msg.SubscriptionStatus(**subscription._asdict())

    def _to_query_message(self, query: WaitingStatus) -> Any:
        memories = [
            self._msg.AwaitedMemory(memory.id, _to_ros_time(memory.instant), _to_ros_duration(memory.behind))
            for memory in query.memories
        ]
        return self._msg.WaitingStatus(query.event, _to_ros_time(query.since), memories, query.left_out)

    def _to_input_message(self, status: InputStatus) -> Any:
        age = None if status.age is None else int(status.age * SECOND)
        return self._msg.InputStatus(
            **status._replace(age=_to_ros_duration(age), lag=_to_ros_duration(status.lag or 0))._asdict()
        )


def _to_ros_time(instant: Optional[int]) -> Any:
    """Return an instant as ROS time: zero for None, and the nearest representable one if it is out of range."""
    return rospy.Time(0, min(max(instant or 0, 0), _TIME_LIMIT_SECONDS * SECOND - 1))


def _to_ros_duration(nanoseconds: Optional[int]) -> Any:
    """Return a time span as ROS duration: -1 ns for None, and the nearest representable one if it is out of range."""
    span = NO_DURATION if nanoseconds is None else nanoseconds
    return rospy.Duration(
        0, min(max(span, -_DURATION_LIMIT_SECONDS * SECOND), _DURATION_LIMIT_SECONDS * SECOND - 1)
    )


DEFAULT_MAX_SOLUTIONS = 100
"""Default number of solutions of a query."""

MAX_SOLUTIONS = 100_000
"""Limit for the solutions of a query."""

DEFAULT_QUERY_WAIT_SECONDS = 10.0
"""Default time in seconds that a query waits for memories."""

MAX_WAITING_QUERIES = 50
"""Limit for queries that wait for memories at the same time: each holds a thread and a connection."""

MAX_EXPLANATION_LINE_CHARACTERS = MAX_ANSWER_CHARACTERS
"""Limit for the characters of a line of an explanation."""

MAX_EXPLANATION_SECONDS = 2.0
"""Limit in seconds for the search for an explanation: the engine processes no events meanwhile."""

MAX_EXPLANATION_LINES = 1_000
"""Limit for the lines of an explanation."""

ORIGINS_NOT_RECORDED = (
    "what events come from is not recorded: "
    "start the node with ~explain (explain:=true with roslaunch), or call set_etalis_flag(etalis_justification, on)"
)


class QueryServices:
    """Services ``~query`` and ``~explain`` of node retalis.

    Args:
        engine: engine of the node.
    """

    def __init__(self, engine: Engine):
        from .. import msg, srv  # noqa: PLC0415 - generated when the package is built

        self._engine = engine
        self._msg, self._srv = msg, srv
        self._waiting_slots = BoundedSemaphore(MAX_WAITING_QUERIES)
        offer_service("~query", srv.Query, self._query)
        offer_service("~explain", srv.Explain, self._explain)

    def _query(self, request: Any) -> Any:
        response = self._srv.QueryResponse
        try:
            seconds = validate_limit("seconds", request.seconds, float)
            # Zero represents an absent value in a ROS message. The output limit is the engine's.
            limits = Limits(seconds or None, request.inferences or None, output_megabytes=None)
            solution_limit = min(request.max_solutions or DEFAULT_MAX_SOLUTIONS, MAX_SOLUTIONS)
            if request.wait_for:
                self._wait_for_memories(request)
            answers = ask(self._engine, request.goal, solution_limit, limits)
        except SyntaxFault as fault:
            return response(f"error: goal: {fault.brief()}", False, [])
        except RetalisError as error:
            return response(format_error(error), False, [])
        solutions = [
            self._msg.Solution([self._msg.Binding(*binding) for binding in solution])
            for solution in answers.solutions
        ]
        return response(OK, answers.complete, solutions)

    def _wait_for_memories(self, request: Any) -> None:
        names = [parse_name(text, "wait_for") for text in request.wait_for]
        seconds = validate_limit("timeout", request.timeout, float) or DEFAULT_QUERY_WAIT_SECONDS
        # A query beyond the limit fails at once instead of waiting: a blocked thread is what the limit avoids.
        if not self._waiting_slots.acquire(blocking=False):
            raise UsageError(f"{MAX_WAITING_QUERIES} queries wait already")
        try:
            wait_for_memories(self._engine, names, request.stamp.to_nsec(), seconds)
        finally:
            self._waiting_slots.release()

    def _explain(self, request: Any) -> Any:
        response = self._srv.ExplainResponse
        if not records_origins(self._engine):
            return response(f"error: {ORIGINS_NOT_RECORDED}", False, [])
        try:
            explanation = explain(self._engine, request.event, MAX_EXPLANATION_SECONDS)
        except RetalisError as error:
            return response(format_error(error), False, [])
        lines: List[str] = []
        for tree in explanation.lines:
            lines += tree.indented()
            if len(lines) > MAX_EXPLANATION_LINES:
                lines = [*lines[:MAX_EXPLANATION_LINES], "..."]
                break
        return response(OK, explanation.happened, [line[:MAX_EXPLANATION_LINE_CHARACTERS] for line in lines])


MAX_RELOAD_ERROR_CHARACTERS = 10_000
"""Limit for the errors in a response: a program may have several, each with its source line."""

TOPICS_CHANGED = f"topics: {TOPICS} has changed; its topics change when the node is started again"


class ReloadService:
    """Service ``~reload`` of node retalis.

    Args:
        engine: engine of the node.
        folder: folder of the program.
        writable: folders in which goals may write files; None means anywhere.
        topics: topics of the program when the node started.
        after_reload: called with the present topics after the program has been read again.
    """

    def __init__(
        self,
        engine: Engine,
        folder: Path,
        writable: Optional[Tuple[str, ...]],
        topics: Topics,
        after_reload: Callable[[Topics], None],
    ):
        from .. import srv  # noqa: PLC0415 - generated when the package is built

        self._engine = engine
        self._folder = folder
        self._writable = writable
        self._topics = topics
        self._after_reload = after_reload
        self._response = srv.ReloadResponse
        rospy.Service("~reload", srv.Reload, self._reload)

    def _reload(self, request: Any) -> Any:
        try:
            check_not_writable(self._folder, self._writable)
            topics = read_current_topics(self._folder)
            # The engine replaces the program completely, or not at all if there are errors.
            changes = self._engine.reload(self._folder)
        except RetalisError as error:
            # In several lines: the source lines, with carets below the errors.
            return self._response(f"error: {shorten(str(error), MAX_RELOAD_ERROR_CHARACTERS)}", [])
        if topics != self._topics:
            changes.append(TOPICS_CHANGED)
        self._after_reload(topics)
        rospy.loginfo("%s was read again: %s", self._folder, self._engine.summary())
        return self._response(OK, changes)


def check_not_writable(folder: Path, writable: Optional[Tuple[str, ...]]) -> None:
    """Check that no goal may write into a program's folder.

    The goals and rules of a program have more permissions than those of services. A goal that a service calls could
    therefore extend its permissions by writing a program.

    Raises:
        UsageError: if goals may write into the folder.
    """
    # Resolved paths: a symbolic link must not hide that one folder contains the other.
    real_folder = os.path.realpath(folder)
    for folder_of_goals in ("/",) if writable is None else writable:
        real_writable = os.path.realpath(folder_of_goals)
        if os.path.commonpath((real_folder, real_writable)) == real_writable:
            raise UsageError(
                f"{folder} is in {folder_of_goals} of ~write_folders: goals of services could write the program; "
                "restart the node to have it read again"
            )


def read_current_topics(folder: Path) -> Topics:
    """Return the topics of a program; none if its file of topics does not exist, as when the node starts.

    Raises:
        ProgramErrors: if the file has errors.
    """
    try:
        return read_topics(folder / TOPICS)
    except UsageError:
        return Topics()
