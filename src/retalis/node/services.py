"""Services of a node.

* `EngineServices`: subscriptions and memories; `InterfaceServices`: subscriptions of input topics;
* `RuleServices`: ``~add_rule`` and ``~delete_rule``;
* `ListService`: ``~list``, the contents of a node with counters;
* `QueryServices`: ``~query`` and ``~explain``;
* `ReloadService`: ``~reload``, which reads the program's folder again.

A handler gets a request with its fields as attributes, and returns the fields of the response. The field ``result``
of each response is ``ok``, or ``error: `` with the reason. A handler runs in a thread of the transport and hands its
work to the engine, which executes it between two events.
"""

import logging
import os
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..engine.client_requests import add_rule, ask, delete_rule, run_restricted, wait_for_memories
from ..engine.engine import Engine
from ..engine.engine_status import Status, WaitingStatus
from ..engine.runtime.problem_reports import Reports
from ..events.language.stream_parser import subscription_event
from ..events.program.topic_configuration import TOPICS, Topics, read_topics, topic_type
from ..explanation.event_and_output_explanations import explain, records_origins
from ..foundation.displayed_text import printable, shorten
from ..foundation.errors import ProgramErrors, RetalisError, SyntaxFault, UsageError
from ..foundation.ros_name_checks import topic_fault
from ..messages.type_registry import Definitions
from ..prolog.machine.resource_limits import Limits, validate_limit
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.terms.list_terms import conjuncts, make_list
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import COMMA, TRUE, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .goal_output import log_counts
from .published_topics import UntypedTopicWarnings
from .topic_statistics import InputStatus
from .transport import Transport

log = logging.getLogger("retalis")

Response = Dict[str, Any]
"""Fields of the response of a service."""

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


def offer_service(
    transport: Transport, name: str, service_type: str, handler: Callable[[Any], Response]
) -> None:
    """Offer a service whose requests have a limited number of characters."""

    def handle(request: Any) -> Response:
        size = sum(len(value) for value in _iterate_texts(request))
        if size > MAX_REQUEST_CHARACTERS:
            limit = MAX_REQUEST_CHARACTERS
            return {"result": f"error: the request has {size} characters: expected at most {limit}"}
        return handler(request)

    transport.offer_service(name, service_type, handle)


def _iterate_texts(request: Any) -> Iterator[str]:
    for value in vars(request).values():
        if isinstance(value, str):
            yield value
        elif isinstance(value, list):
            yield from value


def execute_request(execute: Callable[[], None]) -> Response:
    """Execute a request; the result is ``ok``, or the reason in one line with the position in the text."""
    try:
        execute()
    except RetalisError as error:
        return {"result": format_error(error)}
    return {"result": OK}


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
        transport: the middleware.
        untyped_topics: warns about subscribed topics without a type.
        explain_missing_source: returns the reason why no events of a pattern are expected; "" if there may be some.
        explain_type_mismatch: returns the reason why no output of a subscription, a goal ``subscribe/5``, can be a
            message of its topic's type; "" if some may be.
    """

    def __init__(
        self,
        transport: Transport,
        engine: Engine,
        untyped_topics: UntypedTopicWarnings,
        explain_missing_source: Callable[[Term], str],
        explain_type_mismatch: Callable[[CompoundTerm, str], str],
    ):
        self._engine = engine
        self._untyped_topics = untyped_topics
        self._explain_missing_source = explain_missing_source
        self._explain_type_mismatch = explain_type_mismatch
        offer_service(transport, "add_output_subscription", "AddOutputSubscription", self._add_subscription)
        offer_service(
            transport, "delete_output_subscription", "DeleteOutputSubscription", self._delete_subscription
        )
        offer_service(transport, "add_memory", "AddMemory", self._add_memory)
        offer_service(transport, "delete_memory", "DeleteMemory", self._delete_memory)

    def _add_subscription(self, request: Any) -> Response:
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

    def _add_memory(self, request: Any) -> Response:
        def execute() -> None:
            key, size = parse_name(request.id, "id"), self._parse_size(request.size)
            if self._engine.has_memory(key):
                raise UsageError(f"a memory {quote_text(request.id)} already exists")
            fields = self._parse_request(request)
            self._engine.add_memory(fields.event, fields.conditions, fields.template, key, size)
            self._log_unbound_variables("memorize", request.id, fields)
            self._log_missing_source("memorize", request.id, fields)

        return execute_request(lambda: run_restricted(self._engine, execute))

    def _delete_subscription(self, request: Any) -> Response:
        def execute() -> None:
            topic, key = parse_name(request.topic, "topic"), parse_name(request.id, "id")
            if not self._engine.delete_subscription(topic, key):
                raise UsageError(
                    f"there is no subscription {quote_text(request.id)} of topic {quote_text(request.topic)}"
                )

        return execute_request(execute)

    def _delete_memory(self, request: Any) -> Response:
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
            log.warning(
                "%s %s: nothing in event or conditions gives %s in the format a value",
                goal,
                quote_text(text),
                " and ".join(fields.unbound_names),
            )

    def _log_missing_source(self, goal: str, text: str, fields: _Fields) -> None:
        """Log the reason why no events of the pattern are expected, if there is one."""
        missing_source = self._explain_missing_source(fields.event)
        if missing_source:
            log.warning("%s %s: %s", goal, quote_text(text), printable(missing_source))

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
    """The services for input topics.

    Args:
        transport: the middleware.
        definitions: known message types.
        subscribe: subscribes to a topic with a message type; raises a `UsageError` for an invalid name, or if the
            topic is subscribed already.
        unsubscribe: unsubscribes from a topic; raises a `UsageError` if it is not subscribed.
    """

    def __init__(
        self,
        transport: Transport,
        definitions: Definitions,
        subscribe: Callable[[str, str], object],
        unsubscribe: Callable[[str], object],
    ):
        self._transport = transport
        self._definitions = definitions
        self._subscribe = subscribe
        self._unsubscribe = unsubscribe
        offer_service(transport, "add_input_subscription", "AddInputSubscription", self._add)
        offer_service(transport, "delete_input_subscription", "DeleteInputSubscription", self._delete)

    def _add(self, request: Any) -> Response:
        topic, message_type = request.topic.strip(), request.message_type.strip()

        def execute() -> None:
            # Rejects invalid names before any lookup.
            topic_type(topic, message_type)
            is_known = message_type in self._definitions
            suggestion = (
                "" if is_known else Definitions(self._transport.installed_types()).misspelt(message_type)
            )
            # An unknown type is not an error: a publisher's connection header contains its definition.
            if suggestion and not self._is_published(topic, message_type):
                raise UsageError(
                    f"message_type: there is no type '{quote_text(message_type)}' here; did you mean {suggestion}? "
                    "If a publisher is to bring the type, start the publisher first"
                )
            self._subscribe(topic, message_type)
            if not is_known:
                log.warning(
                    "topic %s is subscribed as %s, which is not known here: it is learned from a publisher",
                    quote_text(topic),
                    message_type,
                )

        return execute_request(execute)

    def _delete(self, request: Any) -> Response:
        def execute() -> None:
            self._unsubscribe(request.topic.strip())

        return execute_request(execute)

    def _is_published(self, topic: str, message_type: str) -> bool:
        """Return whether a publisher of a topic with this type is known."""
        graph = self._transport.graph()
        return graph is not None and graph.types.get(self._transport.resolve_topic(topic)) == message_type


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
    """Services ``~add_rule`` and ``~delete_rule`` of node retalis."""

    def __init__(self, transport: Transport, engine: Engine):
        self._engine = engine
        offer_service(transport, "~add_rule", "AddRule", self._add)
        offer_service(transport, "~delete_rule", "DeleteRule", self._delete)

    def _add(self, request: Any) -> Response:
        try:
            return {"result": OK, "label": add_rule(self._engine, request.rule, request.label)}
        except (SyntaxFault, ProgramErrors) as error:
            # In several lines: the source lines, with carets below the errors.
            return {"result": f"error: {shorten(str(error), MAX_ANSWER_CHARACTERS)}"}
        except RetalisError as error:
            return {"result": format_error(error)}

    def _delete(self, request: Any) -> Response:
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
        transport: the middleware.
        inputs: returns the counters of the subscribed topics.
        status: returns the status of the engine with a limited number of items of each kind; None without an engine.
        reports: problem counts of a node without an engine.
        forwarding: returns the state of forwarding; "" if nothing is forwarded.
    """

    def __init__(
        self,
        transport: Transport,
        inputs: Callable[[], Sequence[InputStatus]],
        status: Optional[Callable[[int], Status]] = None,
        reports: Optional[Reports] = None,
        forwarding: Callable[[], str] = str,
    ):
        self._transport = transport
        self._get_forwarding = forwarding
        self._get_inputs = inputs
        self._get_status = status
        self._reports = reports
        transport.offer_service("~list", "List", self._list)

    def _list(self, request: Any) -> Response:
        # Each kind is cut separately, and the response has the number of omitted items.
        limit = min(request.most or DEFAULT_LISTED_ITEMS, MAX_LISTED_ITEMS)
        inputs = self._get_inputs()
        response: Response = {
            "result": OK,
            "inputs": [_describe_input(status) for status in inputs[:limit]],
            "more_inputs": max(0, len(inputs) - limit),
            "forwarding": self._get_forwarding(),
        }
        if self._get_status is None:
            response["now"] = self._transport.now()
            if self._reports is not None:
                response.update(errors=self._reports.errors, warnings=self._reports.warnings)
        else:
            response.update(_describe_engine(self._get_status(limit)))
        # `Reports` counts the problems of events, and `log_counts` all other records of the log; see `goal_output`.
        response["errors"] = response.get("errors", 0) + log_counts.errors
        response["warnings"] = response.get("warnings", 0) + log_counts.warnings
        return response


def _describe_engine(status: Status) -> Response:
    response: Response = {
        "now": _limit_time(status.now),
        "rules": [rule._replace(last_fired=_limit_time(rule.last_fired))._asdict() for rule in status.rules],
        "memories": [
            memory._replace(oldest=_limit_time(memory.oldest), newest=_limit_time(memory.newest))._asdict()
            for memory in status.memories
        ],
        "subscriptions": [subscription._asdict() for subscription in status.subscriptions],
        "waiting": [_describe_query(query) for query in status.waiting],
    }
    for field in ("taken", "fired", "queued", "dropped", "errors", "warnings", "alarms"):
        response[field] = getattr(status, field)
    for field, count in status.left_out._asdict().items():
        response[f"more_{field}"] = count
    if status.work is not None:
        response.update(
            work=status.work.what,
            work_goal=status.work.goal,
            work_place=status.work.place,
            work_time=_limit_duration(int(status.work.seconds * SECOND)),
        )
    return response


def _describe_query(query: WaitingStatus) -> Response:
    memories = [
        {"id": memory.id, "instant": _limit_time(memory.instant), "behind": _limit_duration(memory.behind)}
        for memory in query.memories
    ]
    return {
        "event": query.event,
        "since": _limit_time(query.since),
        "memories": memories,
        "left_out": query.left_out,
    }


def _describe_input(status: InputStatus) -> Response:
    age = None if status.age is None else int(status.age * SECOND)
    return status._replace(age=_limit_duration(age), lag=_limit_duration(status.lag or 0))._asdict()


def _limit_time(instant: Optional[int]) -> int:
    """Return an instant in ns: zero for None, and the nearest one of a message's range if it is out of range."""
    return min(max(instant or 0, 0), _TIME_LIMIT_SECONDS * SECOND - 1)


def _limit_duration(nanoseconds: Optional[int]) -> int:
    """Return a time span in ns: -1 for None, and the nearest one of a message's range if it is out of range."""
    span = NO_DURATION if nanoseconds is None else nanoseconds
    return min(max(span, -_DURATION_LIMIT_SECONDS * SECOND), _DURATION_LIMIT_SECONDS * SECOND - 1)


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
    """Services ``~query`` and ``~explain`` of node retalis."""

    def __init__(self, transport: Transport, engine: Engine):
        self._engine = engine
        self._waiting_slots = BoundedSemaphore(MAX_WAITING_QUERIES)
        offer_service(transport, "~query", "Query", self._query)
        offer_service(transport, "~explain", "Explain", self._explain)

    def _query(self, request: Any) -> Response:
        try:
            seconds = validate_limit("seconds", request.seconds, float)
            # Zero represents an absent value in a ROS message. The output limit is the engine's.
            limits = Limits(seconds or None, request.inferences or None, output_megabytes=None)
            solution_limit = min(request.max_solutions or DEFAULT_MAX_SOLUTIONS, MAX_SOLUTIONS)
            if request.wait_for:
                self._wait_for_memories(request)
            answers = ask(self._engine, request.goal, solution_limit, limits)
        except SyntaxFault as fault:
            return {"result": f"error: goal: {fault.brief()}"}
        except RetalisError as error:
            return {"result": format_error(error)}
        solutions = [
            {"bindings": [binding._asdict() for binding in solution]} for solution in answers.solutions
        ]
        return {"result": OK, "complete": answers.complete, "solutions": solutions}

    def _wait_for_memories(self, request: Any) -> None:
        names = [parse_name(text, "wait_for") for text in request.wait_for]
        seconds = validate_limit("timeout", request.timeout, float) or DEFAULT_QUERY_WAIT_SECONDS
        # A query beyond the limit fails at once instead of waiting: a blocked thread is what the limit avoids.
        if not self._waiting_slots.acquire(blocking=False):
            raise UsageError(f"{MAX_WAITING_QUERIES} queries wait already")
        try:
            wait_for_memories(self._engine, names, request.stamp, seconds)
        finally:
            self._waiting_slots.release()

    def _explain(self, request: Any) -> Response:
        if not records_origins(self._engine):
            return {"result": f"error: {ORIGINS_NOT_RECORDED}"}
        try:
            explanation = explain(self._engine, request.event, MAX_EXPLANATION_SECONDS)
        except RetalisError as error:
            return {"result": format_error(error)}
        lines: List[str] = []
        for tree in explanation.lines:
            lines += tree.indented()
            if len(lines) > MAX_EXPLANATION_LINES:
                lines = [*lines[:MAX_EXPLANATION_LINES], "..."]
                break
        return {
            "result": OK,
            "happened": explanation.happened,
            "lines": [line[:MAX_EXPLANATION_LINE_CHARACTERS] for line in lines],
        }


MAX_RELOAD_ERROR_CHARACTERS = 10_000
"""Limit for the errors in a response: a program may have several, each with its source line."""

TOPICS_CHANGED = f"topics: {TOPICS} has changed; its topics change when the node is started again"


class ReloadService:
    """Service ``~reload`` of node retalis.

    Args:
        transport: the middleware.
        folder: folder of the program.
        writable: folders in which goals may write files; None means anywhere.
        topics: topics of the program when the node started.
        after_reload: called with the present topics after the program has been read again.
    """

    def __init__(
        self,
        transport: Transport,
        engine: Engine,
        folder: Path,
        writable: Optional[Tuple[str, ...]],
        topics: Topics,
        after_reload: Callable[[Topics], None],
    ):
        self._transport = transport
        self._engine = engine
        self._folder = folder
        self._writable = writable
        self._topics = topics
        self._after_reload = after_reload
        transport.offer_service("~reload", "Reload", self._reload)

    def _reload(self, request: Any) -> Response:
        try:
            check_not_writable(self._folder, self._writable)
            topics = read_current_topics(self._folder)
            self._transport.refresh_ros_parameters()
            # The engine replaces the program completely, or not at all if there are errors.
            changes = self._engine.reload(self._folder)
        except RetalisError as error:
            # In several lines: the source lines, with carets below the errors.
            return {"result": f"error: {shorten(str(error), MAX_RELOAD_ERROR_CHARACTERS)}"}
        if topics != self._topics:
            changes.append(TOPICS_CHANGED)
        self._after_reload(topics)
        log.info("%s was read again: %s", self._folder, self._engine.summary())
        return {"result": OK, "changes": changes}


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
